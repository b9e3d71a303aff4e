"""Checks of the modules' motion at 1 ms: latches, joints, ground, collisions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import DenseStretch, compute_anchor_pose, iterate_stretches
from climbplan.limms.check.kinematics import compute_ground_end_frame, compute_mated_end_frame
from climbplan.limms.check.limits import judge
from climbplan.limms.check.worst import WorstResiduals
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec
from climbplan.verification.check import Check

_DRIVING = 1
_STABLE = 1


def check_motion(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """Yield all checks of modules."""
    worst = WorstResiduals()
    has_tested_all = False
    for stretch in iterate_stretches(plan, module):
        _check_joints(plan, module, stretch, worst)
        _check_latches(plan, stretch, worst)
        _check_ground(plan, module, stretch, worst)
        _check_collisions(plan, module, stretch, worst, test_all=not has_tested_all)
        has_tested_all = True
    yield worst.check("latch.position")
    yield worst.check("latch.rotation")
    yield _check_dwell(plan, module)
    for name in (
        "kinematics.joint_bounds",
        "speed.limit",
        "ground.contact",
        "ground.speed",
        "ground.support",
    ):
        yield worst.check(name)
    for name in (
        "limbs.collision",
        "limbs.box_collision",
        "limbs.module_collision",
        "limbs.self_collision",
    ):
        yield worst.check(name, gap=True)


def _check_joints(
    plan: LimmsPlan, module: ModuleSpec, stretch: DenseStretch, worst: WorstResiduals
) -> None:
    """Check joint ranges and speeds, and the stored points."""
    for m, name in enumerate(plan.module_names):
        excess = np.abs(stretch.angles[:, m]) - np.array(module.joint_range)
        worst.update("kinematics.joint_bounds", stretch.time, excess, name)
        speed = np.abs(stretch.rates[:, m]) - module.max_joint_speed
        worst.update("speed.limit", stretch.time, speed, name)
        # Stored points are those of the kinematic chain
        motion = plan.motion
        span = slice(stretch.first, stretch.last + 1)
        computed = stretch.points[m].position[np.searchsorted(stretch.time, motion.time[span])]
        error = np.abs(computed - motion.joint_position[span, m]).max(axis=(1, 2))
        worst.update("latch.position", motion.time[span], error, f"{name}, stored points")


def _check_latches(plan: LimmsPlan, stretch: DenseStretch, worst: WorstResiduals) -> None:
    """Check position and rotation of latched ends."""
    motion = plan.motion
    for m, name in enumerate(plan.module_names):
        for end, anchors in enumerate((motion.base_anchor, motion.tip_anchor)):
            anchor = int(anchors[stretch.first, m])
            if anchor < 0:
                continue
            label = f"{name}, {'last' if end else 'first'} end"
            if anchor >= len(plan.anchor_names):
                parent, parent_end = divmod(anchor - len(plan.anchor_names), 2)
                target = stretch.points[parent].position[:, 7 * parent_end]
                carrying = stretch.points[parent].rotation[:, 7 * parent_end]
                target_frame = compute_mated_end_frame(carrying, parent_end, end)
                rotation_error = np.abs(stretch.points[m].rotation[:, 7 * end] - target_frame)
            else:
                pose = compute_anchor_pose(plan, anchor, end, stretch.box, stretch.yaw)
                target = pose.position
                rotation_error = np.abs(stretch.points[m].rotation[:, 7 * end] - pose.rotation)
            position_error = np.linalg.norm(
                stretch.points[m].position[:, 7 * end] - target, axis=-1
            )
            worst.update("latch.position", stretch.time, position_error, label)
            worst.update("latch.rotation", stretch.time, rotation_error, label)


def _check_dwell(plan: LimmsPlan, module: ModuleSpec) -> Check:
    """Return the check of the shortest time that a latch was closed; latches closed at the end are
    left out.
    """
    motion = plan.motion
    shortfall, location = -np.inf, ""
    for m, name in enumerate(plan.module_names):
        for anchors in (motion.base_anchor[:, m], motion.tip_anchor[:, m]):
            edges = [0, *(np.flatnonzero(np.diff(anchors)) + 1).tolist(), len(anchors)]
            for first, last in pairwise(edges):
                if anchors[first] < 0 or first == 0 or last == len(anchors):
                    continue
                closed_time = float(motion.time[last - 1] - motion.time[first])
                if module.latch_dwell - closed_time > shortfall:
                    shortfall = module.latch_dwell - closed_time
                    location = f"{name}, closed at {motion.time[first]:.3f} s"
    if shortfall == -np.inf:
        return judge("latch.dwell", 0.0)
    margin = f"{module.latch_dwell - shortfall:.2f} s closed" if shortfall < 0 else ""
    return judge("latch.dwell", shortfall, location, margin)


def _check_ground(
    plan: LimmsPlan, module: ModuleSpec, stretch: DenseStretch, worst: WorstResiduals
) -> None:
    """Check ends on the ground: position, attitude and speed."""
    motion = plan.motion
    for m, name in enumerate(plan.module_names):
        end = int(motion.ground_end[stretch.first, m])
        is_driving = motion.mode[stretch.first, m] == _DRIVING
        is_adrift = is_driving and end < 0 and not _is_on_stable_box(plan, stretch.first, m)
        worst.update("ground.support", stretch.time[:1], np.array([float(is_adrift)]), name)
        if end < 0:
            continue
        end_position = stretch.points[m].position[:, 7 * end]
        worst.update(
            "ground.contact", stretch.time, _measure_ground_distance(plan, end_position), name
        )
        rotation_error = stretch.points[m].rotation[:, 7 * end] - compute_ground_end_frame(end)
        worst.update("ground.contact", stretch.time, np.abs(rotation_error), f"{name} upright")
        span = slice(stretch.first, stretch.last + 1)
        path, time = motion.joint_position[span, m, 7 * end], motion.time[span]
        speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / np.diff(time)
        limit = module.ground_speed if is_driving else 0.0
        worst.update("ground.speed", time[1:], speed - limit, name)


def _is_on_stable_box(plan: LimmsPlan, sample: int, m: int) -> bool:
    """Return whether a module is held by a box that stands."""
    motion = plan.motion
    anchors = (int(motion.base_anchor[sample, m]), int(motion.tip_anchor[sample, m]))
    boxes = [a // 4 for a in anchors if 0 <= a < 4 * len(plan.box_size)]
    return any(int(motion.box_mode[sample, b]) == _STABLE for b in boxes)


def _measure_ground_distance(plan: LimmsPlan, points: Array) -> Array:
    """Return the distances (M,) of points from the tops of solids [m]."""
    distance = np.full(len(points), np.inf)
    for low, high in plan.solids:
        horizontal = np.maximum(np.maximum(low[:2] - points[:, :2], points[:, :2] - high[:2]), 0)
        candidate = np.hypot(np.linalg.norm(horizontal, axis=1), points[:, 2] - high[2])
        distance = np.minimum(distance, candidate)
    return distance


def _check_collisions(
    plan: LimmsPlan,
    module: ModuleSpec,
    stretch: DenseStretch,
    worst: WorstResiduals,
    test_all: bool,
) -> None:
    """Check gaps of all that moves; with `test_all` also of what rests."""
    radius = module.radius
    count = len(plan.module_names)
    segments = [link_segments(points, radius) for points in stretch.points]
    is_moving = [test_all or bool(np.ptp(s, axis=0).max() > 1e-12) for s in segments]
    half = plan.box_size / 2
    box_moves = max(np.ptp(values, axis=0).max() for values in (stretch.box, stretch.yaw)) > 1e-12
    for m, name in enumerate(plan.module_names):
        if is_moving[m]:
            gap = gap_to_blocks(segments[m], plan.solids[:, 0], plan.solids[:, 1], radius)
            worst.update("limbs.collision", stretch.time, -gap, name)
            worst.update(
                "limbs.self_collision", stretch.time, -gap_within(segments[m], radius), name
            )
        if is_moving[m] or box_moves:
            gap = gap_to_boxes(segments[m], stretch.box, stretch.yaw, half, radius)
            worst.update("limbs.box_collision", stretch.time, -gap, name)
    for a, b in combinations(range(count), 2):
        if is_moving[a] or is_moving[b]:
            gap = gap_between(segments[a], segments[b], radius)
            names = f"{plan.module_names[a]} and {plan.module_names[b]}"
            worst.update("limbs.module_collision", stretch.time, -gap, names)
