"""The report of a bookshelf plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from climbplan.bookshelf.plan import ShelfPlan
from climbplan.bookshelf.plan_file import FORMAT, FORMAT_VERSION, read_shelf_plan
from climbplan.bookshelf.verification import verify
from climbplan.plans.verification import Verification
from climbplan.reports.bookshelf_figures import UNITS, key_figures
from climbplan.reports.bookshelf_page import build_page
from climbplan.reports.figure_shelf import gallery_pages, statistics, the_scene
from climbplan.reports.report_files import finite, write_files
from climbplan.reports.sheet import png


def report_dict(plan_path: Path) -> dict[str, object]:
    """The report of a plan file as JSON-ready values.

    The root attributes of the file, the verification made anew, timings, sizes, times and costs
    over the scenes, the costliest of them, and those without a placement; units are listed under
    "units". Raises PlanFileError for a damaged file.
    """
    return _report(read_shelf_plan(plan_path), verify(plan_path))


def write_report(
    plan_path: Path, directory: Path, verification: Verification | None = None
) -> None:
    """Write report.json, report.html and figures/*.png of a plan file into a directory.

    verification: of this very file if it was made already. Each file is written aside and renamed.
    Raises PlanFileError for a damaged plan and UsageError where the directory cannot be written
    to.
    """
    plan = read_shelf_plan(plan_path)
    report = _report(plan, verification or verify(plan_path))
    images = {name: png(draw(plan)) for name, draw in figure_functions(plan).items()}
    write_files(directory, report, build_page(plan, report, images), images)


def figure_functions(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """The figures of a plan by file name."""
    if len(plan.scenes) == 1:
        return {"scene": the_scene}
    return {"statistics": statistics, **gallery_pages(plan)}


def _report(plan: ShelfPlan, verification: Verification) -> dict[str, Any]:
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
