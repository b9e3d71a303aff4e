"""Checks of the boxes: dynamics, forces, support, goal (eqs. (6.5) to (6.8)).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import (
    compute_anchor_pose,
    find_events,
    interpolate_hermite,
    refine_times,
)
from climbplan.limms.check.kinematics import compute_yaw_rotation
from climbplan.limms.check.limits import judge
from climbplan.limms.check.loads import inertia_about_vertical
from climbplan.limms.check.worst import WorstResiduals
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS
from climbplan.limms.schema.module import ModuleSpec
from climbplan.verification.check import Check

_STABLE, _FREE, _HELD, _QUADRUPED = 1, 2, 3, 4
_GOAL_TOLERANCE = 1e-4  # [m, rad]
_YAW_TOLERANCE = 1e-9  # [rad]; a box with less between start and goal keeps its yaw


def check_boxes(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """Yield all checks of the boxes."""
    worst = WorstResiduals()
    for first, last in find_events(plan.motion.time):
        _check_motion(plan, first, last, worst)
        for b in range(len(plan.box_size)):
            _check_forces(plan, module, b, first, last, worst)
    for name in ("box.kinematics", "box.dynamics", "box.stable", "box.moment"):
        yield worst.check(name)
    yield worst.check("box.collision", gap=True)
    for name in ("latch.moment", "force.limit", "force.friction", "force.without_contact"):
        yield worst.check(name)
    yield worst.check("support.sides", gap=True)
    yield from _check_goals(plan)


def _check_goals(plan: LimmsPlan) -> Iterator[Check]:
    """Yield checks that all boxes end at their goals, and arrive one after the other."""
    count = plan.deliveries
    names = [f"box {b}" if count > 1 else "" for b in range(count)]
    distance = np.linalg.norm(plan.motion.box_position[-1] - plan.goal, axis=-1)[:count]
    index = int(np.argmax(distance))
    yield judge(
        "goal.position", distance[index], names[index], f"{1e3 * distance[index]:.3f} mm off"
    )
    yaw_error = _compute_yaw_errors(plan)
    index = int(np.argmax(yaw_error))
    location = (
        (names[index] if index < count else f"parked box {index - count}")
        if yaw_error.any()
        else ""
    )
    yield judge(
        "goal.rotation",
        yaw_error[index],
        location,
        f"{np.degrees(yaw_error[index]):.4f} degrees off",
    )
    # Only the last box may still move
    speed = np.linalg.norm(plan.motion.box_velocity[-1, :count], axis=-1)
    allowed = np.array([*np.zeros(count - 1), plan.arrival_speed])
    excess = speed - allowed
    # A box that arrives at rest does not rotate either
    excess = np.maximum(
        excess, np.where(allowed > 0, 0, np.abs(plan.motion.box_yaw_rate[-1, :count]))
    )
    index = int(np.argmax(excess))
    yield judge("goal.speed", excess[index], names[index], f"{speed[index]:.3f} m/s at the end")
    arrivals = np.array([_find_arrival(plan, b) for b in range(count)])
    early = arrivals[:-1] - arrivals[1:]
    delay = max(float(early.max(initial=0.0)), 0.0)
    location = f"box {int(np.argmax(early)) + 1} before the one it comes after" if delay else ""
    yield judge("goal.order", delay, location)


def _compute_yaw_errors(plan: LimmsPlan) -> Array:
    """Return the final yaw error of each box (B,) [rad], its largest ever if it keeps its yaw."""
    yaw = plan.motion.box_yaw
    ends = np.abs((yaw[-1] - plan.goal_yaw + np.pi) % (2 * np.pi) - np.pi)
    yaw_change = np.abs((plan.goal_yaw - yaw[0] + np.pi) % (2 * np.pi) - np.pi)
    return np.where(
        yaw_change > _YAW_TOLERANCE, ends, np.maximum(ends, np.abs(yaw - yaw[0]).max(axis=0))
    )


def _find_arrival(plan: LimmsPlan, b: int) -> float:
    """Return the time from which a box is where it ends [s]."""
    deviation = np.abs(plan.motion.box_position[:, b] - plan.motion.box_position[-1, b]).max(axis=1)
    deviation = np.maximum(
        deviation, np.abs(plan.motion.box_yaw[:, b] - plan.motion.box_yaw[-1, b])
    )
    not_arrived = np.flatnonzero(deviation > _GOAL_TOLERANCE)
    return float(plan.motion.time[not_arrived[-1]]) if len(not_arrived) else 0.0


def _check_motion(plan: LimmsPlan, first: int, last: int, worst: WorstResiduals) -> None:
    """Check that position, velocity and acceleration are consistent, and that boxes are clear."""
    motion = plan.motion
    span = slice(first, last + 1)
    time = motion.time[span]
    h = np.diff(time)[:, None, None]
    p, v, a = (
        np.concatenate([linear[span], angular[span, :, None]], axis=2)
        for linear, angular in (
            (motion.box_position, motion.box_yaw),
            (motion.box_velocity, motion.box_yaw_rate),
            (motion.box_acceleration, motion.box_yaw_acceleration),
        )
    )
    velocity_error = v[1:] - v[:-1] - h * (a[:-1] + a[1:]) / 2
    position_error = p[1:] - p[:-1] - h * v[:-1] - h**2 * (2 * a[:-1] + a[1:]) / 6
    worst.update("box.kinematics", time[1:], np.abs(velocity_error / h).max(axis=(1, 2)))
    worst.update("box.kinematics", time[1:], np.abs(position_error / h).max(axis=(1, 2)))
    times = refine_times(time)
    placement, _ = interpolate_hermite(time, p, v, times)
    box, yaw = placement[..., :3], placement[..., 3]
    for anchor in range(4 * len(plan.box_size)):
        anchor_position = compute_anchor_pose(plan, anchor, 0, p[..., :3], p[..., 3]).position
        error = np.abs(motion.anchor_position[span, anchor] - anchor_position)
        worst.update("box.kinematics", time, error, plan.anchor_names[anchor])
    half = plan.box_size / 2
    for b in range(len(half)):
        for low, high in plan.solids:
            block = (high + low) / 2, np.zeros(1), (high - low) / 2
            gap = upright_gap(box[:, b], yaw[:, b], half[b], *block)
            worst.update("box.collision", times, -gap, f"box {b}")
        for second in range(b):
            block = box[:, second], yaw[:, second], half[second]
            gap = upright_gap(box[:, b], yaw[:, b], half[b], *block)
            worst.update("box.collision", times, -gap, f"box {b}")
        if motion.box_mode[first, b] == _STABLE:
            displacement = np.abs(placement[:, b] - placement[0, b]).max(axis=1)
            bottom = box[:, b].copy()
            bottom[:, 2] -= half[b, 2]
            worst.update(
                "box.stable", times, np.maximum(displacement, _measure_height(plan, bottom))
            )


def _measure_height(plan: LimmsPlan, points: Array) -> Array:
    """Return the distance (M,) of points from the top of the solids below them [m]."""
    height = np.full(len(points), np.inf)
    for low, high in plan.solids:
        is_over = ((points[:, :2] >= low[:2]) & (points[:, :2] <= high[:2])).all(axis=1)
        height = np.minimum(height, np.where(is_over, np.abs(points[:, 2] - high[2]), np.inf))
    return height


def _check_forces(
    plan: LimmsPlan, module: ModuleSpec, b: int, first: int, last: int, worst: WorstResiduals
) -> None:
    """Check dynamics, force limits, friction and moments of one box between two events."""
    motion = plan.motion
    span = slice(first, last + 1)
    time, force = motion.time[span], motion.force[span, b]  # (n, 4, 3)
    mode = int(motion.box_mode[first, b])
    if mode != _STABLE:
        mass = plan.box_mass[b]
        needed = mass * (motion.box_acceleration[span, b] + np.array([0, 0, GRAVITY]))
        worst.update("box.dynamics", time, np.abs(force.sum(axis=1) - needed))
    frame = compute_yaw_rotation(motion.box_yaw[span, b])  # (n, 3, 3) to the world
    needed_moment = np.zeros((len(time), 3))  # moment of the planned rotation
    needed_moment[:, 2] = inertia_about_vertical(plan, b) * motion.box_yaw_acceleration[span, b]
    if mode == _FREE:
        worst.update("box.moment", time, np.abs(needed_moment))
    magnitude = np.linalg.norm(force, axis=-1)
    worst.update("force.limit", time, magnitude - module.max_force)
    holders = _find_holders(plan, b, first)
    for side in range(4):
        m, end = holders[side]
        anchor_name = plan.anchor_names[4 * b + side]
        foot_down = m >= 0 and motion.ground_end[first, m] == 1 - end
        loose = m < 0 or (mode == _QUADRUPED and not foot_down)
        if loose:
            worst.update("force.without_contact", time, magnitude[:, side], anchor_name)
        if mode == _QUADRUPED and m >= 0:
            foot = motion.joint_position[span, m, 7 * (1 - end)]
            normal = SIDE_NORMALS[side]
            half = float(np.abs(normal) @ plan.box_size[b] / 2)
            face_distance = ((foot - motion.box_position[span, b]) * (frame @ normal)).sum(axis=1)
            if foot_down:
                worst.update("support.sides", time, half - face_distance, anchor_name)
                f = force[:, side]
                sliding = np.hypot(f[:, 0], f[:, 1]) - plan.friction * f[:, 2]
                worst.update("force.friction", time, sliding, anchor_name)
    if mode == _QUADRUPED:
        moment = np.zeros((len(time), 3))
        for side, (m, end) in enumerate(holders):
            if m >= 0:
                foot = motion.joint_position[span, m, 7 * (1 - end)]
                moment += np.cross(foot - motion.box_position[span, b], force[:, side])
        worst.update("box.moment", time, np.abs(moment - needed_moment))
    if mode == _HELD:
        held_sides = [side for side in range(4) if holders[side][0] >= 0]
        if not held_sides:
            return
        offsets = (SIDE_NORMALS[held_sides] * plan.box_size[b] / 2) @ np.swapaxes(frame, 1, 2)
        # The remaining moment is shared evenly by the latches
        remaining = needed_moment - np.cross(offsets, force[:, held_sides]).sum(axis=1)
        moment_of_latch = np.linalg.norm(remaining, axis=1) / len(held_sides)
        worst.update("latch.moment", time, moment_of_latch - module.latch_moment)


def _find_holders(plan: LimmsPlan, b: int, sample: int) -> list[tuple[int, int]]:
    """Return module and end on each side of a box, (-1, 0) for none."""
    motion = plan.motion
    holders = [(-1, 0)] * 4
    for m in range(len(plan.module_names)):
        for end, anchors in enumerate((motion.base_anchor, motion.tip_anchor)):
            side = int(anchors[sample, m]) - 4 * b
            if 0 <= side < 4:
                holders[side] = (m, end)
    return holders
