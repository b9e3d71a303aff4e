"""Straight motions of a module's free end along its axis: into an anchor, and out of it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from climbplan.arrays import Array
from climbplan.limms.modules.chain import (
    BRANCHES,
    follow_path,
    range_excess,
    solve_inverse_kinematics,
)
from climbplan.limms.motion.moving import Blocked, add_motion, compute_gaps, compute_rooted_points
from climbplan.limms.motion.timeline import PartialPlan, sample_times
from climbplan.limms.scene.limms_scene import FramePoses
from climbplan.limms.schema.module import ModuleSpec

APPROACH_LENGTHS = (
    0.08,
    0.05,
    0.03,
    0.015,
)  # [m] of the straight motion along the normal of an anchor
SPEED_FRACTION = 0.95
_MAX_STEP = 0.2  # [rad] between samples, which are a few millimetres apart


def plan_straight_approach(
    partial_plan: PartialPlan,
    module: int,
    root: FramePoses,
    root_end: int,
    *,
    target: FramePoses,
    ending: Array,
    length: float,
) -> Array | None:
    """Plan a straight motion along an anchor's normal into it.

    Args:
        partial_plan: Where everything is.
        module: The module that moves.
        root: Pose of its fixed end.
        root_end: The fixed end, 0 first or 1 last.
        target: Pose of the free end when latched; its z axis is along the module.
        ending: Joint angles at the target (6,) [rad].
        length: Length of the motion [m].

    Returns:
        Joint angles (n, 6) that end at `ending`, or None if the motion is impossible.
    """
    scene = partial_plan.scene
    free_end = 1 - root_end
    inward = target.rotation[:, 2] if free_end == 1 else -target.rotation[:, 2]
    fractions = np.linspace(0, 1, 25)
    positions = target.position - length * (1 - fractions)[:, None] * inward
    shape = (len(fractions), 3, 3)
    moving = FramePoses(positions, np.broadcast_to(target.rotation, shape))
    fixed = FramePoses(
        np.broadcast_to(root.position, positions.shape), np.broadcast_to(root.rotation, shape)
    )
    first, last = (fixed, moving) if free_end == 1 else (moving, fixed)
    reversed_path = follow_path(
        scene.module,
        FramePoses(first.position[::-1], first.rotation),
        FramePoses(last.position[::-1], last.rotation),
        ending,
    )
    path = reversed_path.angles[::-1]
    if reversed_path.reach_error.max() > 0 or np.abs(path[-1] - ending).max() > 1e-3:
        return None
    if (
        range_excess(scene.module, path).max() > 0
        or np.abs(np.diff(path, axis=0)).max() > _MAX_STEP
    ):
        return None
    gap = compute_gaps(
        partial_plan, module, compute_rooted_points(partial_plan, root, root_end, path), root_end
    )
    return None if gap.min() < -1e-9 else path


def retract(
    partial_plan: PartialPlan, module: int, root: FramePoses, root_end: int, name: str
) -> None:
    """Add a motion that draws the free end back along its axis.

    Raises:
        Blocked: Something is in the way.
    """
    free_end = 7 if root_end == 0 else 0
    points = partial_plan.points(module)
    pose = FramePoses(points.position[free_end], points.rotation[free_end])
    for length in APPROACH_LENGTHS:
        path = plan_straight_approach(
            partial_plan,
            module,
            root,
            root_end,
            target=pose,
            ending=partial_plan.angles[module],
            length=length,
        )
        if path is not None:
            follow_line(partial_plan, module, root, root_end, path[::-1], name)
            return
    raise Blocked(f"{name}: module {partial_plan.scene.module_names[module]} cannot draw back")


def follow_line(
    partial_plan: PartialPlan, module: int, root: FramePoses, root_end: int, path: Array, name: str
) -> None:
    """Add a motion of one module whose free end moves straight, through angles (n, 6).

    Inverse kinematics is solved at every sample, so the end stays on its line.
    """
    scene = partial_plan.scene
    ends = compute_rooted_points(partial_plan, root, root_end, path[[0, -1]])
    free_end = 7 if root_end == 0 else 0
    rotation = ends.rotation[0, free_end]
    max_rate = scene.pace * SPEED_FRACTION * scene.module.max_joint_speed
    travel = float(np.abs(np.diff(path, axis=0)).max(axis=1).max() * (len(path) - 1))
    duration = max(1.6 * travel / max_rate, 0.1)
    times = sample_times(duration)
    s = times / duration
    fraction = (3 * s**2 - 2 * s**3)[:, None]
    positions = ends.position[0, free_end] + fraction * (
        ends.position[1, free_end] - ends.position[0, free_end]
    )
    shape = (len(times), 3, 3)
    moving = FramePoses(positions, np.broadcast_to(rotation, shape))
    fixed = FramePoses(
        np.broadcast_to(root.position, positions.shape), np.broadcast_to(root.rotation, shape)
    )
    first, last = (fixed, moving) if free_end == 7 else (moving, fixed)
    angles = follow_path(scene.module, first, last, path[0]).angles
    rates = compute_rates(times, angles)
    rates[[0, -1]] = 0.0
    add_motion(
        partial_plan,
        module,
        compute_rooted_points(partial_plan, root, root_end, angles),
        time=times,
        angles=angles,
        rates=rates,
        name=name,
    )


def select_branch(
    module: ModuleSpec, first: FramePoses, last: FramePoses, start: Array, end: Array
) -> Array:
    """Return the angles (n, 6) of the branch that is nearest to `start` and `end` at its ends."""
    best, error = None, np.inf
    for branch in BRANCHES:
        angles = np.unwrap(solve_inverse_kinematics(module, first, last, branch).angles, axis=0)
        angles = angles + np.round((start - angles[0]) / (2 * np.pi)) * 2 * np.pi
        deviation = float(max(np.abs(angles[0] - start).max(), np.abs(angles[-1] - end).max()))
        if deviation < error:
            best, error = angles, deviation
    assert best is not None
    return best


def compute_rates(time: Array, angles: Array) -> Array:
    """Compute joint speeds (n, ...) of densely sampled angles by a cubic spline."""
    if len(time) < 4:
        return np.gradient(angles, time, axis=0)
    rates: Array = CubicSpline(time, angles, axis=0).derivative()(time)
    return rates
