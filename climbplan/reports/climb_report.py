"""The report of a climb plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from climbplan.plans.climb_file import read_climb
from climbplan.plans.climb_layout import FORMAT_VERSION, FORMATS
from climbplan.plans.climb_plan import ClimbPlan
from climbplan.plans.verification import Verification, verify
from climbplan.reports.climb_figures import UNITS, key_figures
from climbplan.reports.figure_forces import forces
from climbplan.reports.figure_postures import postures
from climbplan.reports.figure_region import region
from climbplan.reports.figure_safety import safety
from climbplan.reports.figure_series import friction, torque
from climbplan.reports.page import build_page
from climbplan.reports.plan_spec import plan_spec
from climbplan.reports.report_files import finite, write_files
from climbplan.reports.sheet import png

FIGURES: Mapping[str, Callable[[ClimbPlan], Figure]] = {
    "postures": postures,
    "torque": torque,
    "friction": friction,
    "safety": safety,
    "forces": forces,
}


def report_dict(plan_path: Path) -> dict[str, object]:
    """The report of a plan file as JSON-ready values.

    The root attributes of the file, the verification made anew, timings, sizes and the key figures
    of a climb; SI units, listed under "units". Raises PlanFileError for a damaged file.
    """
    return _report(read_climb(plan_path), verify(plan_path))


def write_report(
    plan_path: Path, directory: Path, verification: Verification | None = None
) -> None:
    """Write report.json, report.html and figures/*.png of a plan file into a directory.

    verification: of this very file if it was made already. Each file is written aside and renamed.
    Raises PlanFileError for a damaged plan and UsageError where the directory cannot be written
    to.
    """
    plan = read_climb(plan_path)
    report = _report(plan, verification or verify(plan_path))
    images = {name: png(draw(plan)) for name, draw in figure_functions(plan).items()}
    page = build_page(plan, report, {"Postures": images["postures"]})
    write_files(directory, report, page, images)


def figure_functions(plan: ClimbPlan) -> dict[str, Callable[[ClimbPlan], Figure]]:
    """The figures of a plan by file name; the feasible region only with a study."""
    return {**FIGURES, **({"region": region} if plan.study is not None else {})}


def _report(plan: ClimbPlan, verification: Verification) -> dict[str, Any]:
    spec = plan_spec(plan)
    return {
        "format": FORMATS[plan.kind],
        "format_version": FORMAT_VERSION,
        "climbplan_version": plan.climbplan_version,
        "created": plan.created,
        "name": plan.name,
        "title": spec.title if spec is not None else "",
        "robot": {
            "name": plan.robot.name,
            "mass": plan.robot.mass,
            "limbs": list(plan.robot.limb_names),
        },
        "spec": plan.spec_text,
        "spec_sha256": plan.spec_sha256,
        "seed": plan.seed,
        "status": plan.status,
        "verified": verification.passed,
        "objective": plan.objective,
        "bound": plan.bound,
        "gap": plan.gap,
        "timings": finite(plan.timings),
        "solvers": finite(plan.solvers),
        "sizes": finite(plan.sizes),
        "verification": [check.as_dict() for check in verification.checks],
        "warnings": list(plan.warnings),
        **key_figures(plan),
        "figures": [f"figures/{name}.png" for name in figure_functions(plan)],
        "units": UNITS,
    }
