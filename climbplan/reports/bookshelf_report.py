"""The report of a bookshelf plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from matplotlib.figure import Figure

from climbplan.bookshelf.plan import ShelfPlan
from climbplan.bookshelf.plan_file import FORMAT, FORMAT_VERSION, read_shelf_plan
from climbplan.bookshelf.verification import verify
from climbplan.plans.verification import Verification
from climbplan.reports.bookshelf_figures import UNITS, key_figures
from climbplan.reports.bookshelf_page import build_page
from climbplan.reports.figure_shelf import gallery_pages, statistics, the_scene
from climbplan.reports.plan_report import PlanReport
from climbplan.reports.report_files import finite


def figure_functions(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """The figures of a plan by file name."""
    if len(plan.scenes) == 1:
        return {"scene": the_scene}
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
