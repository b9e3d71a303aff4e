"""The report of a LIMMS plan: report.json, figures, and the HTML page with its replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.limms.check.verification import verify
from climbplan.limms.modules.loads import compute_loads
from climbplan.limms.pages.page import build_page
from climbplan.limms.plan.file import FORMAT, FORMAT_VERSION, read_limms_plan
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.plan.summary import list_box_modes, list_module_modes
from climbplan.reports.plan_report import FigureOf, PlanReport
from climbplan.reports.report_files import replace_non_finite
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {
    "objective": "m",
    "timings.*": "s",
    "duration": "s",
    "box.mass": "kg",
    "box.goal": "m",
    "box.final_speed": "m/s",
    "box.modes.*.1": "s",
    "boxes.*.mass": "kg",
    "boxes.*.goal": "m",
    "boxes.*.modes.*.1": "s",
    "stages.*.begin": "s",
    "stages.*.end": "s",
    "modules.*.force": "N",
    "modules.*.torque": "N m",
    "modules.*.modes.*.1": "s",
    "convergence.box_*": "m",
    "convergence.points_*": "m",
    "convergence.axes_*": "rad",
    "convergence.missed": "m",
    "convergence.violation": "m",
    "convergence.*_seconds": "s",
    "limits.force": "N",
    "limits.torque": "N m",
    "limits.own_weight_torque": "N m",
}


FIGURES: Mapping[str, Callable[[LimmsPlan], Figure]] = {
    "modes": FigureOf("climbplan.limms.pages.figure_modes:plot_modes"),
    "poses": FigureOf("climbplan.limms.pages.figure_modules:plot_key_poses"),
    "loads": FigureOf("climbplan.limms.pages.figure_loads:plot_loads"),
}


def select_figures(plan: LimmsPlan) -> Mapping[str, Callable[[LimmsPlan], Figure]]:
    """Return the figures of a plan."""
    if plan.convergence is None:
        return FIGURES
    return {
        **FIGURES,
        "convergence": FigureOf("climbplan.limms.pages.figure_convergence:plot_convergence"),
    }


def _build_values(plan: LimmsPlan, verification: Verification) -> dict[str, Any]:
    """Return root attributes, checks, times, sizes, stages, and loads of each module."""
    loads, last = compute_loads(plan), plan.deliveries - 1
    report = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "climbplan_version": plan.climbplan_version,
        "created": plan.created,
        "name": plan.name,
        "title": plan.title,
        "method": plan.method,
        "sequence": plan.sequence,
        "spec": plan.spec_text,
        "spec_sha256": plan.spec_sha256,
        "seed": plan.seed,
        "status": plan.status,
        "verified": verification.passed,
        **verification.scope(),
        "objective": plan.objective,
        "timings": plan.timings,
        "solvers": plan.solvers,
        "sizes": plan.sizes,
        "verification": [check.as_dict() for check in verification.checks],
        "warnings": list(plan.warnings),
        "notes": list(plan.notes),
        "duration": float(plan.motion.time[-1]),
        "box": {
            "mass": float(plan.box_mass[0]),
            "goal": plan.goal[0].tolist(),
            "goal_yaw": float(plan.goal_yaw[0]),
            "final_yaw": float(plan.motion.box_yaw[-1, 0]),
            "final_speed": float(np.linalg.norm(plan.motion.box_velocity[-1, last])),
            "modes": [[BOX_MODES[mode], seconds] for mode, seconds in list_box_modes(plan)],
        },
        "boxes": [_build_box_values(plan, b) for b in range(plan.deliveries)],
        "stages": [{"name": n, "begin": a, "end": b} for n, a, b in plan.stages],
        "modules": [
            {
                "name": name,
                "force": float(loads.force[:, m].max()),
                "torque": float(loads.torque[:, m].max()),
                "modes": [[MODULE_MODES[k], seconds] for k, seconds in list_module_modes(plan, m)],
            }
            for m, name in enumerate(plan.module_names)
        ],
        "limits": {
            "force": plan.module["max_force"],
            "torque": loads.limit,
            "own_weight_torque": loads.own_weight,
        },
        "figures": [f"figures/{name}.png" for name in select_figures(plan)],
        "units": UNITS,
    }
    if plan.convergence is not None:
        record = vars(plan.convergence)
        report["convergence"] = {key: values.tolist() for key, values in record.items()}
    finite_values: dict[str, Any] = replace_non_finite(report)
    return finite_values


def _build_box_values(plan: LimmsPlan, b: int) -> dict[str, Any]:
    """Return mass, goal, final yaw and times of modes of a box."""
    return {
        "mass": float(plan.box_mass[b]),
        "goal": plan.goal[b].tolist(),
        "goal_yaw": float(plan.goal_yaw[b]),
        "final_yaw": float(plan.motion.box_yaw[-1, b]),
        "modes": [[BOX_MODES[mode], seconds] for mode, seconds in list_box_modes(plan, b)],
    }


_REPORT = PlanReport(read_limms_plan, verify, _build_values, select_figures, build_page)
build_report = _REPORT.build_report
write_report = _REPORT.write_report
write_values = _REPORT.write_values
