"""Checks of the modules' motion at 1 ms: latches, joints, ground, collisions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import Stretch, anchor_pose, stretches
from climbplan.limms.check.kinematics import is_on_ground, on_end
from climbplan.limms.check.limits import judge
from climbplan.limms.check.worst import Worst
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


def motion_checks(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """Everything about modules, stretch by stretch."""
    worst = Worst()
    seen_still = False
    for stretch in stretches(plan, module):
        _joints(plan, module, stretch, worst)
        _latches(plan, stretch, worst)
        _ground(plan, module, stretch, worst)
        _collisions(plan, module, stretch, worst, everything=not seen_still)
        seen_still = True
    yield worst.check("latch.position")
    yield worst.check("latch.rotation")
    yield _dwell(plan, module)
    for name in ("joint.range", "joint.speed", "ground.stand", "ground.speed", "ground.free"):
        yield worst.check(name)
    for name in ("clear.solids", "clear.boxes", "clear.modules", "clear.self"):
        yield worst.check(name, gap=True)


def _joints(plan: LimmsPlan, module: ModuleSpec, stretch: Stretch, worst: Worst) -> None:
    for m, name in enumerate(plan.module_names):
        excess = np.abs(stretch.angles[:, m]) - np.array(module.joint_range)
        worst.look("joint.range", stretch.time, excess, name)
        speed = np.abs(stretch.rates[:, m]) - module.max_joint_speed
        worst.look("joint.speed", stretch.time, speed, name)
        # What is stored is what the chain gives between the samples too
        motion = plan.motion
        span = slice(stretch.first, stretch.last + 1)
        own = stretch.points[m].position[np.searchsorted(stretch.time, motion.time[span])]
        off = np.abs(own - motion.joint_position[span, m]).max(axis=(1, 2))
        worst.look("latch.position", motion.time[span], off, f"{name}, stored points")


def _latches(plan: LimmsPlan, stretch: Stretch, worst: Worst) -> None:
    motion = plan.motion
    for m, name in enumerate(plan.module_names):
        for end, anchors in enumerate((motion.base_anchor, motion.tip_anchor)):
            anchor = int(anchors[stretch.first, m])
            if anchor < 0:
                continue
            what = f"{name}, {'last' if end else 'first'} end"
            if anchor >= len(plan.anchor_names):
                parent, its_end = divmod(anchor - len(plan.anchor_names), 2)
                target = stretch.points[parent].position[:, 7 * its_end]
                carrying = stretch.points[parent].rotation[:, 7 * its_end]
                joined = on_end(carrying, its_end, end)
                turn = np.abs(stretch.points[m].rotation[:, 7 * end] - joined)
            else:
                pose = anchor_pose(plan, anchor, end, stretch.box, stretch.yaw)
                target = pose.position
                turn = np.abs(stretch.points[m].rotation[:, 7 * end] - pose.rotation)
            off = np.linalg.norm(stretch.points[m].position[:, 7 * end] - target, axis=-1)
            worst.look("latch.position", stretch.time, off, what)
            worst.look("latch.rotation", stretch.time, turn, what)


def _dwell(plan: LimmsPlan, module: ModuleSpec) -> Check:
    """The shortest time that a latch stayed closed, those closed at the end left out."""
    motion = plan.motion
    short, where = -np.inf, ""
    for m, name in enumerate(plan.module_names):
        for anchors in (motion.base_anchor[:, m], motion.tip_anchor[:, m]):
            edges = [0, *(np.flatnonzero(np.diff(anchors)) + 1).tolist(), len(anchors)]
            for first, last in pairwise(edges):
                if anchors[first] < 0 or first == 0 or last == len(anchors):
                    continue
                held = float(motion.time[last - 1] - motion.time[first])
                if module.latch_dwell - held > short:
                    short = module.latch_dwell - held
                    where = f"{name}, closed at {motion.time[first]:.3f} s"
    if short == -np.inf:
        return judge("latch.dwell", 0.0)
    margin = f"{module.latch_dwell - short:.2f} s closed" if short < 0 else ""
    return judge("latch.dwell", short, where, margin)


def _ground(plan: LimmsPlan, module: ModuleSpec, stretch: Stretch, worst: Worst) -> None:
    motion = plan.motion
    for m, name in enumerate(plan.module_names):
        end = int(motion.ground_end[stretch.first, m])
        driving = motion.mode[stretch.first, m] == _DRIVING
        adrift = driving and end < 0 and not _on_stable_box(plan, stretch.first, m)
        worst.look("ground.free", stretch.time[:1], np.array([float(adrift)]), name)
        if end < 0:
            continue
        place = stretch.points[m].position[:, 7 * end]
        worst.look("ground.stand", stretch.time, _off_ground(plan, place), name)
        turn = stretch.points[m].rotation[:, 7 * end] - is_on_ground(end)
        worst.look("ground.stand", stretch.time, np.abs(turn), f"{name} upright")
        span = slice(stretch.first, stretch.last + 1)
        path, time = motion.joint_position[span, m, 7 * end], motion.time[span]
        speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / np.diff(time)
        limit = module.ground_speed if driving else 0.0
        worst.look("ground.speed", time[1:], speed - limit, name)


def _on_stable_box(plan: LimmsPlan, sample: int, m: int) -> bool:
    """Whether a module is held by a box that stands."""
    motion = plan.motion
    anchors = (int(motion.base_anchor[sample, m]), int(motion.tip_anchor[sample, m]))
    boxes = [a // 4 for a in anchors if 0 <= a < 4 * len(plan.box_size)]
    return any(int(motion.box_mode[sample, b]) == _STABLE for b in boxes)


def _off_ground(plan: LimmsPlan, points: Array) -> Array:
    """Distance (M,) of points from the tops of solids that are free above."""
    best = np.full(len(points), np.inf)
    for low, high in plan.solids:
        flat = np.maximum(np.maximum(low[:2] - points[:, :2], points[:, :2] - high[:2]), 0)
        off = np.hypot(np.linalg.norm(flat, axis=1), points[:, 2] - high[2])
        best = np.minimum(best, off)
    return best


def _collisions(
    plan: LimmsPlan, module: ModuleSpec, stretch: Stretch, worst: Worst, everything: bool
) -> None:
    """Gaps of all that moves; what rests was looked at before (`everything`: look at all)."""
    radius = module.radius
    count = len(plan.module_names)
    segments = [link_segments(points, radius) for points in stretch.points]
    moving = [everything or bool(np.ptp(s, axis=0).max() > 1e-12) for s in segments]
    half = plan.box_size / 2
    box_moves = max(np.ptp(each, axis=0).max() for each in (stretch.box, stretch.yaw)) > 1e-12
    for m, name in enumerate(plan.module_names):
        if moving[m]:
            gap = gap_to_blocks(segments[m], plan.solids[:, 0], plan.solids[:, 1], radius)
            worst.look("clear.solids", stretch.time, -gap, name)
            worst.look("clear.self", stretch.time, -gap_within(segments[m], radius), name)
        if moving[m] or box_moves:
            gap = gap_to_boxes(segments[m], stretch.box, stretch.yaw, half, radius)
            worst.look("clear.boxes", stretch.time, -gap, name)
    for a, b in combinations(range(count), 2):
        if moving[a] or moving[b]:
            gap = gap_between(segments[a], segments[b], radius)
            names = f"{plan.module_names[a]} and {plan.module_names[b]}"
            worst.look("clear.modules", stretch.time, -gap, names)
