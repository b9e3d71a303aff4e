"""Motions of single modules: driving on the ground, and bringing a free end to an anchor.

One module moves at a time, while all else rests. Paths are straight in joint space where that is
free, else planned by random trees. The last centimetres to an anchor follow its normal.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import forward, range_excess
from climbplan.limms.modules.rrt import plan_path
from climbplan.limms.motion.moving import Blocked, add_motion, compute_gaps, compute_rooted_points
from climbplan.limms.motion.straight_motion import (
    APPROACH_LENGTHS,
    SPEED_FRACTION,
    follow_line,
    plan_straight_approach,
    retract,
)
from climbplan.limms.motion.timeline import PartialPlan, sample_times
from climbplan.limms.scene.limms_scene import FramePoses, Points

PATH_CLEARANCE = 0.004  # [m] kept along paths
_DRIVING_CLEARANCE = 2e-3  # [m] kept while driving
_STEPS = (0.06, 0.02)  # [rad] between tested poses, the second if the first fails
_FINE_STEP = 0.01  # [rad] between poses of the final test
_MAX_ROLL = np.pi  # [rad] of rolls that trees explore


def _time_polyline(corners: Array, max_rate: float) -> tuple[Array, Array, Array]:
    """Return times, values and rates along a polyline, at rest at its corners.

    Args:
        corners: Corners (n, d).
        max_rate: Largest rate of any coordinate.
    """
    times, values, rates = [np.zeros(1)], [corners[:1]], [np.zeros_like(corners[:1])]
    for first, last in itertools.pairwise(corners):
        duration = max(1.5 * float(np.abs(last - first).max()) / max_rate, 0.02)
        t = sample_times(duration)
        s = t / duration
        fraction, slope = 3 * s**2 - 2 * s**3, (6 * s - 6 * s**2) / duration
        times.append(times[-1][-1] + t[1:])
        values.append(first + fraction[1:, None] * (last - first))
        rates.append(slope[1:, None] * (last - first))
    return np.concatenate(times), np.concatenate(values), np.concatenate(rates)


def _sample_polyline(corners: Array) -> Array:
    """Return points (n, d) of a polyline at a fine step."""
    pieces = [corners[:1]]
    for first, last in itertools.pairwise(corners):
        num_steps = max(int(np.ceil(np.abs(last - first).max() / _FINE_STEP)), 1)
        pieces.append(first + np.linspace(0, 1, num_steps + 1)[1:, None] * (last - first))
    return np.concatenate(pieces)


def _build_free_test(
    partial_plan: PartialPlan, module: int, root: FramePoses, root_end: int, margin: float
) -> Callable[[Array], BoolArray]:
    """Return a test of joint angles (n, 6) [rad]: in range, and `margin` [m] off everything."""

    def free(angles: Array) -> BoolArray:
        is_free = range_excess(partial_plan.scene.module, angles, 1e-3) <= 0
        if is_free.any():
            points = compute_rooted_points(partial_plan, root, root_end, angles[is_free])
            is_free[is_free] = compute_gaps(partial_plan, module, points, root_end) >= margin
        return np.asarray(is_free)

    return free


def move_joints(
    partial_plan: PartialPlan,
    module: int,
    root: FramePoses,
    root_end: int,
    *,
    goal: Array,
    name: str,
    rng: np.random.Generator,
    margin: float = PATH_CLEARANCE,
) -> None:
    """Add a motion of one module to joint angles `goal`, its root end fixed.

    Raises:
        Blocked: No free path was found.
    """
    scene = partial_plan.scene
    start = partial_plan.angles[module]
    limits = np.array(scene.module.joint_range)
    span = np.minimum(limits, _MAX_ROLL + 0.5)
    lower = np.maximum(np.minimum(start, goal) - span, -limits)
    upper = np.minimum(np.maximum(start, goal) + span, limits)
    free = _build_free_test(partial_plan, module, root, root_end, margin)
    for step in _STEPS:
        path = plan_path(start, goal, lower, upper, is_free=free, step=step, rng=rng)
        if path is None:
            raise Blocked(f"{name}: no free way for module {scene.module_names[module]}")
        # Between two tested poses an end moves further than its clearance
        if (
            compute_gaps(
                partial_plan,
                module,
                compute_rooted_points(partial_plan, root, root_end, _sample_polyline(path)),
                root_end,
            ).min()
            >= 0
        ):
            break
    else:
        raise Blocked(f"{name}: module {scene.module_names[module]} passes something too closely")
    time, angles, rates = _time_polyline(
        path, scene.pace * SPEED_FRACTION * scene.module.max_joint_speed
    )
    add_motion(
        partial_plan,
        module,
        compute_rooted_points(partial_plan, root, root_end, angles),
        time=time,
        angles=angles,
        rates=rates,
        name=name,
    )


def reach(
    partial_plan: PartialPlan,
    module: int,
    root: FramePoses,
    root_end: int,
    *,
    target: FramePoses,
    ending: Array,
    name: str,
    rng: np.random.Generator,
) -> None:
    """Add a motion that brings the free end of a module into an anchor, with final angles `ending`.

    Raises:
        Blocked: No free path was found.
    """
    for length in APPROACH_LENGTHS:
        approach = plan_straight_approach(
            partial_plan, module, root, root_end, target=target, ending=ending, length=length
        )
        if approach is not None:
            approach_start = compute_rooted_points(partial_plan, root, root_end, approach[:1])
            if compute_gaps(partial_plan, module, approach_start, root_end)[0] >= PATH_CLEARANCE:
                break
    else:
        raise Blocked(f"{name}: no free straight end of the way")
    approach_angles = approach[0]
    current = compute_rooted_points(partial_plan, root, root_end, partial_plan.angles[module][None])
    if compute_gaps(partial_plan, module, current, root_end)[0] < PATH_CLEARANCE:
        # The module is closer to something than paths allow: it draws back first
        retract(partial_plan, module, root, root_end, name)
    move_joints(partial_plan, module, root, root_end, goal=approach_angles, name=name, rng=rng)
    follow_line(partial_plan, module, root, root_end, approach, name)


def drive(
    partial_plan: PartialPlan, module: int, goal: Array, name: str, rng: np.random.Generator
) -> None:
    """Add a motion of an upright module to a point of the same ground.

    Raises:
        Blocked: No free path was found.
    """
    scene = partial_plan.scene
    start = partial_plan.base_position[module]
    angles = partial_plan.angles[module]
    rotation = partial_plan.base_rotation[module]

    def points(places: Array) -> Points:
        base = FramePoses(places, np.broadcast_to(rotation, (len(places), 3, 3)))
        return forward(scene.module, base, np.broadcast_to(angles, (len(places), 6)))

    def free(positions: Array) -> BoolArray:
        places = np.column_stack([positions, np.full(len(positions), start[2])])
        is_on_patch = np.zeros(len(positions), bool)
        for patch in scene.patches:
            if abs(patch.height - start[2]) < 1e-6:
                is_on_patch |= patch.contains(places, scene.module.radius)
        if is_on_patch.any():
            is_on_patch[is_on_patch] = (
                compute_gaps(partial_plan, module, points(places[is_on_patch])) >= margin
            )
        return is_on_patch

    # Between two tested places a corner comes nearer by at most step^2 / (8 radius).
    # Where an end of the path is closer to something, places are tested more densely
    ends = np.array([start, [*goal[:2], start[2]]])
    gap = float(compute_gaps(partial_plan, module, points(ends)).min())
    margin, step = (_DRIVING_CLEARANCE, 0.02) if gap >= _DRIVING_CLEARANCE else (-1e-6, 0.004)

    low = np.min([p.lower for p in scene.patches], axis=0)
    high = np.max([p.upper for p in scene.patches], axis=0)
    path = plan_path(start[:2], goal[:2], low, high, is_free=free, step=step, rng=rng)
    if path is None:
        raise Blocked(f"{name}: no free way on the ground")
    corners = np.column_stack([path, np.full(len(path), start[2])])
    speed = scene.pace * SPEED_FRACTION * scene.module.ground_speed
    time, positions_of_path = _time_driving(corners, speed)
    if len(time) < 2:
        return
    fixed_angles = np.tile(angles, (len(time), 1))
    add_motion(
        partial_plan,
        module,
        points(positions_of_path),
        time=time,
        angles=fixed_angles,
        rates=np.zeros_like(fixed_angles),
        name=name,
    )


def _time_driving(corners: Array, speed: float) -> tuple[Array, Array]:
    """Return times (n,) and positions (n, 3) along a polyline, at rest at its corners.

    Args:
        corners: Corners (m, 3) [m].
        speed: Largest speed [m/s].
    """
    times, positions = [np.zeros(1)], [corners[:1]]
    for first, last in itertools.pairwise(corners):
        length = float(np.linalg.norm(last - first))
        if length < 1e-9:
            continue
        t = sample_times(1.5 * length / speed)
        s = t / t[-1]
        times.append(times[-1][-1] + t[1:])
        positions.append(first + (3 * s**2 - 2 * s**3)[1:, None] * (last - first))
    return np.concatenate(times), np.concatenate(positions)
