"""The numbers behind the page's charts and 3-D views, rounded and compact.

Lengths of moving things are integers of 0.1 mm, angles of 0.1 mrad, forces of 0.01 N.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import BoolArray
from climbplan.climb.pages.cones import force_scale
from climbplan.climb.pages.patches import (
    Box,
    Patch,
    climb_box,
    hull_faces,
    limb_points,
    oblique_camera,
    shoulder_ring,
    solid_faces,
    surface_patches,
)
from climbplan.climb.pages.replay import build_replay
from climbplan.climb.pages.series import instant_labels, limb_series, round_spans
from climbplan.climb.pages.study_grid import study_axes
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.reports import palette
from climbplan.terrain.solids import Solid

LENGTH, ANGLE, FORCE = 1e-4, 1e-4, 1e-2  # [m], [rad], [N] per integer
_LONGEST_FORCE = 0.28  # [m] length of the largest force in the 3-D views


def _integers(values: NDArray[Any], unit: float) -> list[int]:
    """All values in multiples of a unit, row by row."""
    return [int(v) for v in np.rint(np.asarray(values) / unit).ravel()]


def _rounded(values: NDArray[Any], digits: int) -> list[float | None]:
    """All values row by row; None for what is not finite."""
    flat = np.asarray(values, float).ravel()
    return [round(float(v), digits) if np.isfinite(v) else None for v in flat]


def _bits(rows: BoolArray) -> list[str]:
    """Rows of a mask as texts of 0 and 1."""
    return ["".join("1" if flag else "0" for flag in row) for row in rows]


def _patch(patch: Patch) -> dict[str, Any]:
    return {"v": np.round(patch.vertices, 4).tolist(), "n": np.round(patch.normal, 4).tolist()}


def _solid(solid: Solid, box: Box) -> dict[str, Any]:
    return {"name": solid.name, "faces": [_patch(face) for face in solid_faces(solid, box)]}


def _scene(plan: ClimbPlan) -> dict[str, Any]:
    """What stands still: terrain near the climb, footholds, shape of the robot."""
    box = climb_box(plan)
    camera = oblique_camera(plan, -63.0, 18.0)
    return {
        "lower": np.round(box.lower, 4).tolist(),
        "upper": np.round(box.upper, 4).tolist(),
        "surfaces": [
            {"name": s.name, "patches": [_patch(p) for p in surface_patches(s, box)]}
            for s in plan.terrain.surfaces
        ],
        "obstacles": [_solid(solid, box) for solid in plan.terrain.obstacles],
        "footholds": _integers(plan.rounds.toes, LENGTH),
        "path": _integers(plan.rounds.com, LENGTH),
        "hull": [_patch(face) for face in hull_faces(plan)],
        "ring": np.round(shoulder_ring(plan), 4).tolist(),
        "shoulders": np.round(plan.robot.shoulder_body, 4).tolist(),
        "limb_radius": plan.robot.limb_radius,
        "gripper": 0.0 if plan.robot.gripper is None else plan.robot.gripper.length,
        "oblique": [camera.azimuth_deg, camera.elevation_deg],
        "force_scale": force_scale(plan, _LONGEST_FORCE),
    }


def _replay(plan: ClimbPlan) -> dict[str, Any]:
    frames = build_replay(plan)
    return {
        "time": _rounded(frames.time, 3),
        "com": _integers(frames.com, LENGTH),
        "rpy": _integers(frames.rpy, ANGLE),
        "joints": _integers(frames.joints, LENGTH),
        "contact": _bits(frames.contact),
        "instant": [int(k) for k in frames.instant],
    }


def _instants(plan: ClimbPlan) -> dict[str, Any]:
    instants, forces = plan.instants, plan.forces
    joints = limb_points(plan, instants.com, instants.rpy, instants.joint_angles)[:, :, 1:]
    return {
        "label": list(instant_labels(plan)),
        "com": _integers(instants.com, LENGTH),
        "rpy": _integers(instants.rpy, ANGLE),
        "joints": _integers(joints, LENGTH),
        "contact": _bits(instants.contact),
        "lifted": _bits(instants.lifted),
        "normal": _rounded(instants.normal, 4),
        "force": _integers(forces.force, FORCE),
        "safety_torque": _rounded(forces.safety_torque, 6),
        "safety_friction": _rounded(forces.safety_friction, 6),
    }


def _limbs(plan: ClimbPlan) -> list[dict[str, Any]]:
    return [
        {
            "name": series.name,
            "color": palette.limb_color(limb),
            "torque": _rounded(series.torque, 3),
            "joint": [series.joint_names[j] for j in series.joint],
            "unit": [series.joint_units[j] for j in series.joint],
            "torque_limit": _rounded(series.torque_limit, 3),
            "torque_planned": _rounded(series.torque_planned, 3),
            "mu_critical": _rounded(series.mu_critical, 6),
            "mu": _rounded(series.mu, 4),
            "mu_planned": _rounded(series.mu_planned, 4),
            "lifted": [[span.first, span.last] for span in series.lifted],
        }
        for limb, series in enumerate(limb_series(plan))
    ]


def _study(plan: ClimbPlan, study: Study) -> dict[str, Any]:
    axes = study_axes(plan, study)
    return {
        "labels": list(Study.LABELS),
        "colors": list(palette.LABELS),
        "axes": [
            {"label": axis.label, "values": axis.values.tolist(), "own": axis.own} for axis in axes
        ],
        "label": study.label.tolist(),
        "detail": list(study.detail),
    }


def page_data(plan: ClimbPlan) -> dict[str, Any]:
    """Everything the page's script draws, ready for JSON."""
    rounds = round_spans(plan)
    return {
        "unit": {"length": LENGTH, "angle": ANGLE, "force": FORCE},
        "scene": _scene(plan),
        "replay": _replay(plan),
        "instants": _instants(plan),
        "limbs": _limbs(plan),
        "rounds": [[int(plan.instants.round[s.first]), s.first, s.last] for s in rounds],
        "asked": {
            "torque": plan.limits.safety_torque,
            "friction": plan.limits.safety_friction,
        },
        "study": _study(plan, plan.study) if plan.study is not None else None,
    }
