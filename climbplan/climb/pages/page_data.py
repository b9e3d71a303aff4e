"""The numbers behind the page's charts and 3-D views, rounded and compact.

Lengths of moving things are integers of 0.1 mm, angles of 0.1 mrad, forces of 0.01 N.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import BoolArray
from climbplan.climb.pages.cones import compute_force_scale
from climbplan.climb.pages.patches import (
    AxisAlignedBox,
    SurfacePolygon,
    choose_oblique_camera,
    compute_climb_box,
    compute_limb_points,
    list_hull_faces,
    list_solid_faces,
    list_surface_patches,
    sort_shoulders,
)
from climbplan.climb.pages.replay import build_replay
from climbplan.climb.pages.series import compute_limb_series, find_round_spans, list_instant_labels
from climbplan.climb.pages.study_grid import build_study_axes
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.reports import palette
from climbplan.terrain.solids import Solid

LENGTH, ANGLE, FORCE = 1e-4, 1e-4, 1e-2  # [m], [rad], [N] per integer
_LONGEST_FORCE = 0.28  # [m] length of the largest force in the 3-D views


def _quantise(values: NDArray[Any], unit: float) -> list[int]:
    """Return all values in multiples of a unit, row by row."""
    return [int(v) for v in np.rint(np.asarray(values) / unit).ravel()]


def _round_values(values: NDArray[Any], digits: int) -> list[float | None]:
    """Return all values row by row; None for what is not finite."""
    flat = np.asarray(values, float).ravel()
    return [round(float(v), digits) if np.isfinite(v) else None for v in flat]


def _encode_mask(rows: BoolArray) -> list[str]:
    """Return rows of a mask as texts of 0 and 1."""
    return ["".join("1" if flag else "0" for flag in row) for row in rows]


def _describe_patch(patch: SurfacePolygon) -> dict[str, Any]:
    return {"v": np.round(patch.vertices, 4).tolist(), "n": np.round(patch.normal, 4).tolist()}


def _describe_solid(solid: Solid, box: AxisAlignedBox) -> dict[str, Any]:
    return {
        "name": solid.name,
        "faces": [_describe_patch(face) for face in list_solid_faces(solid, box)],
    }


def _describe_scene(plan: ClimbPlan) -> dict[str, Any]:
    """Return what stands still: terrain near the climb, footholds, shape of the robot."""
    box = compute_climb_box(plan)
    camera = choose_oblique_camera(plan, -63.0, 18.0)
    return {
        "lower": np.round(box.lower, 4).tolist(),
        "upper": np.round(box.upper, 4).tolist(),
        "surfaces": [
            {"name": s.name, "patches": [_describe_patch(p) for p in list_surface_patches(s, box)]}
            for s in plan.terrain.surfaces
        ],
        "obstacles": [_describe_solid(solid, box) for solid in plan.terrain.obstacles],
        "footholds": _quantise(plan.rounds.toes, LENGTH),
        "path": _quantise(plan.rounds.com, LENGTH),
        "hull": [_describe_patch(face) for face in list_hull_faces(plan)],
        "ring": np.round(sort_shoulders(plan), 4).tolist(),
        "shoulders": np.round(plan.robot.shoulder_body, 4).tolist(),
        "limb_radius": plan.robot.limb_radius,
        "gripper": 0.0 if plan.robot.gripper is None else plan.robot.gripper.length,
        "oblique": [camera.azimuth_deg, camera.elevation_deg],
        "force_scale": compute_force_scale(plan, _LONGEST_FORCE),
    }


def _describe_replay(plan: ClimbPlan) -> dict[str, Any]:
    frames = build_replay(plan)
    return {
        "time": _round_values(frames.time, 3),
        "com": _quantise(frames.com, LENGTH),
        "rpy": _quantise(frames.rpy, ANGLE),
        "joints": _quantise(frames.joints, LENGTH),
        "contact": _encode_mask(frames.contact),
        "instant": [int(k) for k in frames.instant],
    }


def _describe_instants(plan: ClimbPlan) -> dict[str, Any]:
    instants, forces = plan.instants, plan.forces
    joints = compute_limb_points(plan, instants.com, instants.rpy, instants.joint_angles)[:, :, 1:]
    return {
        "label": list(list_instant_labels(plan)),
        "com": _quantise(instants.com, LENGTH),
        "rpy": _quantise(instants.rpy, ANGLE),
        "joints": _quantise(joints, LENGTH),
        "contact": _encode_mask(instants.contact),
        "lifted": _encode_mask(instants.lifted),
        "normal": _round_values(instants.normal, 4),
        "force": _quantise(forces.force, FORCE),
        "safety_torque": _round_values(forces.safety_torque, 6),
        "safety_friction": _round_values(forces.safety_friction, 6),
    }


def _describe_limbs(plan: ClimbPlan) -> list[dict[str, Any]]:
    return [
        {
            "name": series.name,
            "color": palette.choose_limb_color(limb),
            "torque": _round_values(series.torque, 3),
            "joint": [series.joint_names[j] for j in series.joint],
            "unit": [series.joint_units[j] for j in series.joint],
            "torque_limit": _round_values(series.torque_limit, 3),
            "torque_planned": _round_values(series.torque_planned, 3),
            "mu_critical": _round_values(series.mu_critical, 6),
            "mu": _round_values(series.mu, 4),
            "mu_planned": _round_values(series.mu_planned, 4),
            "lifted": [[span.first, span.last] for span in series.lifted],
        }
        for limb, series in enumerate(compute_limb_series(plan))
    ]


def _describe_study(plan: ClimbPlan, study: Study) -> dict[str, Any]:
    axes = build_study_axes(plan, study)
    return {
        "labels": list(Study.LABELS),
        "colors": list(palette.LABELS),
        "axes": [
            {"label": axis.label, "values": axis.values.tolist(), "own": axis.own} for axis in axes
        ],
        "label": study.label.tolist(),
        "detail": list(study.detail),
    }


def build_page_data(plan: ClimbPlan) -> dict[str, Any]:
    """Return everything the page's script draws, ready for JSON."""
    rounds = find_round_spans(plan)
    return {
        "unit": {"length": LENGTH, "angle": ANGLE, "force": FORCE},
        "scene": _describe_scene(plan),
        "replay": _describe_replay(plan),
        "instants": _describe_instants(plan),
        "limbs": _describe_limbs(plan),
        "rounds": [[int(plan.instants.round[s.first]), s.first, s.last] for s in rounds],
        "asked": {
            "torque": plan.limits.safety_torque,
            "friction": plan.limits.safety_friction,
        },
        "study": _describe_study(plan, plan.study) if plan.study is not None else None,
    }
