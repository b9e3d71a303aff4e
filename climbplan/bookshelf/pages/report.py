"""The report of a bookshelf plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from climbplan.bookshelf.check.verification import verify
from climbplan.bookshelf.pages.figures import UNITS, gallery_pages, key_figures
from climbplan.bookshelf.pages.page import build_page
from climbplan.bookshelf.plan.file import FORMAT, FORMAT_VERSION, read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.reports.plan_report import FigureOf, PlanReport
from climbplan.reports.report_files import finite
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_functions(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """The figures of a plan by file name."""
    if len(plan.scenes) == 1:
        return {"scene": FigureOf("climbplan.bookshelf.pages.figure_shelf:the_scene")}
    statistics = FigureOf("climbplan.bookshelf.pages.figure_shelf:statistics")
    return {"statistics": statistics, **gallery_pages(plan)}


def _values(plan: ShelfPlan, verification: Verification) -> dict[str, Any]:
    """Root attributes of the file, checks, times, sizes, and the scenes that matter most."""
    report = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "climbplan_version": plan.climbplan_version,
        "created": plan.created,
        "name": plan.name,
        "title": plan.title,
        "meaning": plan.meaning,
        "method": plan.method,
        "spec": plan.spec_text,
        "spec_sha256": plan.spec_sha256,
        "seed": plan.seed,
        "status": plan.totals.status,
        "verified": verification.passed,
        **verification.scope(),
        "objective": plan.totals.objective,
        "bound": plan.totals.bound,
        "gap": plan.totals.gap,
        "timings": plan.timings,
        "solvers": plan.solvers,
        "sizes": plan.sizes,
        "verification": [check.as_dict() for check in verification.checks],
        "warnings": list(plan.warnings),
        **key_figures(plan),
        "figures": [f"figures/{name}.png" for name in figure_functions(plan)],
        "units": UNITS,
    }
    whole: dict[str, Any] = finite(report)
    return whole


_REPORT = PlanReport(read_shelf_plan, verify, _values, figure_functions, build_page)
report_dict = _REPORT.report_dict
write_report = _REPORT.write_report
write_values = _REPORT.write_values
