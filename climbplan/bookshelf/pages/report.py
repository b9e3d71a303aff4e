"""The report of a bookshelf plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from climbplan.bookshelf.check.verification import verify
from climbplan.bookshelf.pages.figures import UNITS, compute_key_figures, list_gallery_pages
from climbplan.bookshelf.pages.page import build_page
from climbplan.bookshelf.plan.file import FORMAT, FORMAT_VERSION, read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.reports.plan_report import FigureOf, PlanReport
from climbplan.reports.report_files import replace_non_finite
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def list_figures(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """List the figures of a plan by file name."""
    if len(plan.scenes) == 1:
        return {"scene": FigureOf("climbplan.bookshelf.pages.figure_shelf:draw_single_scene")}
    statistics = FigureOf("climbplan.bookshelf.pages.figure_shelf:draw_statistics")
    return {"statistics": statistics, **list_gallery_pages(plan)}


def _build_values(plan: ShelfPlan, verification: Verification) -> dict[str, Any]:
    """Build the report: attributes of the file, checks, times, sizes and key figures."""
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
        "notes": list(plan.notes),
        **compute_key_figures(plan),
        "figures": [f"figures/{name}.png" for name in list_figures(plan)],
        "units": UNITS,
    }
    whole: dict[str, Any] = replace_non_finite(report)
    return whole


_REPORT = PlanReport(read_shelf_plan, verify, _build_values, list_figures, build_page)
build_report = _REPORT.build_report
write_report = _REPORT.write_report
write_values = _REPORT.write_values
