"""The report of a climb plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from climbplan.climb.check.verification import verify
from climbplan.climb.pages.figures import UNITS, compute_key_figures
from climbplan.climb.pages.grip_figures import UNITS as GRIP_UNITS
from climbplan.climb.pages.grip_figures import compute_grip_figures
from climbplan.climb.pages.plan_spec import parse_plan_spec
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.plan.layout import FORMAT_VERSION, FORMATS
from climbplan.reports.plan_report import FigureOf, PlanReport
from climbplan.reports.report_files import replace_non_finite
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES: Mapping[str, Callable[[ClimbPlan], Figure]] = {
    "postures": FigureOf("climbplan.climb.pages.figure_postures:postures"),
    "torque": FigureOf("climbplan.climb.pages.figure_series:torque"),
    "friction": FigureOf("climbplan.climb.pages.figure_series:friction"),
    "safety": FigureOf("climbplan.climb.pages.figure_safety:safety"),
    "forces": FigureOf("climbplan.climb.pages.figure_forces:forces"),
}


def select_figures(plan: ClimbPlan) -> dict[str, Callable[[ClimbPlan], Figure]]:
    """Return the figures of a plan by file name; the feasible region only with a study.

    A transition also has its contact schedule, a robot with grippers its grips.
    """
    plan_figures: dict[str, Callable[[ClimbPlan], Figure]] = {}
    if plan.study is not None:
        plan_figures["region"] = FigureOf("climbplan.climb.pages.figure_region:region")
    if plan.kind == "transition":
        plan_figures["schedule"] = FigureOf("climbplan.climb.pages.figure_schedule:schedule")
    if plan.grips is not None:
        plan_figures["grips"] = FigureOf("climbplan.climb.pages.figure_grips:grips")
    return {**FIGURES, **plan_figures}


def _build_values(plan: ClimbPlan, verification: Verification) -> dict[str, Any]:
    """Return root attributes of the file, checks, times, sizes, and the key figures of a climb."""
    spec = parse_plan_spec(plan)
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
        **verification.scope(),
        "objective": plan.objective,
        "bound": plan.bound,
        "gap": plan.gap,
        "risk": None if plan.promise is None else plan.promise.as_dict(),
        "worlds": None if plan.sample is None else plan.sample.as_dict(),
        "timings": replace_non_finite(plan.timings),
        "solvers": replace_non_finite(plan.solvers),
        "sizes": replace_non_finite(plan.sizes),
        "verification": [check.as_dict() for check in verification.checks],
        "warnings": list(plan.warnings),
        "notes": list(plan.notes),
        **compute_key_figures(plan),
        **compute_grip_figures(plan),
        **_describe_transition(plan),
        "figures": [f"figures/{name}.png" for name in select_figures(plan)],
        "units": UNITS | (GRIP_UNITS if plan.grips is not None else {}),
    }


def _describe_transition(plan: ClimbPlan) -> dict[str, Any]:
    """Return the contact sequence, and all that the search found."""
    if plan.kind != "transition":
        return {}
    rows: list[dict[str, Any]] = []
    if plan.sequences is not None:
        sequences = plan.sequences
        for row, name in enumerate(sequences.name):
            rows.append(
                {
                    "name": name,
                    "cost": float(sequences.cost[row]),
                    "safety_torque": replace_non_finite(float(sequences.safety_torque[row])),
                    "safety_friction": replace_non_finite(float(sequences.safety_friction[row])),
                    "outcome": sequences.outcome[row],
                }
            )
    return {"contact_sequence": plan.contact_sequence, "sequences": rows}


def _build_page(plan: ClimbPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """Return the page draws what is missing here itself."""
    from climbplan.climb.pages.page import build_page

    pictures = ("schedule", "postures", "grips")
    images_shown = {name.capitalize(): images[name] for name in pictures if name in images}
    return build_page(plan, report, images_shown)


_REPORT = PlanReport(read_climb, verify, _build_values, select_figures, _build_page)
build_report = _REPORT.build_report
write_report = _REPORT.write_report
write_values = _REPORT.write_values
