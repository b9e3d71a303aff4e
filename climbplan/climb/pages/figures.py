"""The key figures of a climb plan: what a reader wants to know first."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.pages.plan_spec import parse_plan_spec
from climbplan.climb.pages.series import find_minimum
from climbplan.climb.pages.study_grid import build_study_axes
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.robots.joint_units import torque_unit

# Unit of every number in the report, by dotted key; what is not listed is a pure number.
UNITS = {
    "timings.*": "s",
    "climb.height": "m",
    "climb.path": "m",
    "climb.duration": "s",
    "climb.speed": "m/s",
    "safety.torque.torque": "N m",
    "safety.torque.max_torque": "N m",
    "worst_torque.torque": "N m",
    "worst_torque.max_torque": "N m",
    "load.payload": "kg",
    "load.external_force": "N",
    "load.external_moment": "N m",
    "normal_force.*": "N",
    "sag.*": "m",
    "tilt.*": "rad",
    "penetration.*": "m",
}


def _replace_infinite(value: float) -> float | None:
    """Return a JSON number, None for infinity."""
    return float(value) if np.isfinite(value) else None


def _describe_range(values: Array) -> dict[str, float | None]:
    """Return least and most; None for both of nothing."""
    if values.size == 0:
        return {"least": None, "most": None}
    return {"least": _replace_infinite(values.min()), "most": _replace_infinite(values.max())}


def _describe_joint(plan: ClimbPlan, k: int, limb: int, joint: int) -> dict[str, Any]:
    """Return one joint at one instant."""
    names = plan.robot.limb_names
    return {
        "where": plan.instants.label(k, names),
        "instant": k,
        "limb": names[limb],
        "joint": plan.robot.joint_name(limb, joint),
        "torque": float(abs(plan.forces.motor_torques[k, limb, joint])),
        "torque_unit": torque_unit(plan.robot, limb, joint),
        "max_torque": float(plan.robot.max_torque[limb, joint]),
    }


def _describe_safety(plan: ClimbPlan) -> dict[str, Any]:
    forces, instants = plan.forces, plan.instants
    names = plan.robot.limb_names
    k = find_minimum(forces.safety_torque)
    load = np.abs(forces.motor_torques[k]) / plan.robot.max_torque
    limb, joint = np.unravel_index(int(np.argmax(load)), load.shape)
    m = find_minimum(forces.safety_friction)
    ratio = forces.mu_critical[m] / instants.mu[m]
    slipping = int(np.argmax(ratio))
    return {
        "torque": {
            "least": _replace_infinite(forces.safety_torque[k]),
            "asked": plan.limits.safety_torque,
            **_describe_joint(plan, k, int(limb), int(joint)),
        },
        "friction": {
            "least": _replace_infinite(forces.safety_friction[m]),
            "asked": plan.limits.safety_friction,
            "where": instants.label(m, names),
            "instant": m,
            "limb": names[slipping],
            "mu_critical": float(forces.mu_critical[m, slipping]),
            "mu": float(instants.mu[m, slipping]),
        },
    }


def _find_worst_torque(plan: ClimbPlan) -> dict[str, Any]:
    magnitude = np.abs(plan.forces.motor_torques) * ~plan.robot.slides  # forces are no torques
    k, limb, joint = np.unravel_index(int(np.argmax(magnitude)), magnitude.shape)
    return _describe_joint(plan, int(k), int(limb), int(joint))


def _describe_study(plan: ClimbPlan, study: Study) -> dict[str, Any]:
    axes = build_study_axes(plan, study)
    return {
        "axes": [
            {"key": a.key, "unit": a.unit, "values": a.values.tolist(), "own": a.own} for a in axes
        ],
        "labels": list(Study.LABELS),
        "label": study.label.tolist(),
        "counts": {
            name: int(np.count_nonzero(study.label == i)) for i, name in enumerate(Study.LABELS)
        },
    }


def compute_key_figures(plan: ClimbPlan) -> dict[str, Any]:
    """Return climb, safety, loads, forces, sag and penetration of a plan, SI units (see UNITS)."""
    instants, forces, time = plan.instants, plan.forces, plan.trajectory.time
    spec = parse_plan_spec(plan)
    pressing = instants.contact
    normal = np.einsum("kni,kni->kn", forces.force, instants.normal)[pressing]
    pushed = compute_penetration(plan)[pressing]
    wrench = instants.external_wrench
    path = float(np.linalg.norm(np.diff(plan.rounds.com, axis=0), axis=1).sum())
    duration = float(time[-1] - time[0])
    return {
        "climb": {
            "rounds": plan.rounds.count,
            "instants": instants.count,
            "limbs": plan.robot.limb_count,
            "height": float(plan.rounds.com[-1, 2] - plan.rounds.com[0, 2]),
            "path": path,
            "duration": duration,
            "speed": path / duration if duration > 0 else None,
        },
        "safety": _describe_safety(plan),
        "worst_torque": _find_worst_torque(plan),
        "load": {
            "payload": spec.task.payload.mass if spec is not None else None,
            "external_force": float(np.linalg.norm(wrench[:, :3], axis=1).max()),
            "external_moment": float(np.linalg.norm(wrench[:, 3:], axis=1).max()),
        },
        "normal_force": _describe_range(normal),
        "sag": _describe_range(-forces.com_deflection[:, 2]),
        "tilt": _describe_range(np.linalg.norm(forces.com_deflection[:, 3:], axis=1)),
        "penetration": _describe_range(pushed),
        "study": _describe_study(plan, plan.study) if plan.study is not None else None,
    }


def compute_penetration(plan: ClimbPlan) -> Array:
    """Return depth (K, N) [m] of the toe commands behind the surface, along its normal."""
    into = plan.forces.toe_command - plan.instants.toes
    depth: Array = -np.einsum("kni,kni->kn", into, plan.instants.normal)
    return depth
