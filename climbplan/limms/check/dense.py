"""The motion between its samples: everything anew at 1 ms, from what the samples say."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.kinematics import is_on_ground, on_anchor, on_end, placed, turned
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import Points, Pose
from climbplan.limms.schema.module import ModuleSpec

STEP = 1e-3  # [s]


class Root(NamedTuple):
    """The end of a module that is held, and its pose (M, 3), (M, 3, 3)."""

    end: int
    pose: Pose


@dataclass(frozen=True)
class Stretch:
    """Samples [first, last] without an event between, and M finer times in it."""

    first: int
    last: int
    time: Array  # (M,) [s]
    box: Array  # (M, B, 3) [m]
    velocity: Array  # (M, B, 3) [m/s]
    yaw: Array  # (M, B) [rad]
    yaw_rate: Array  # (M, B) [rad/s]
    angles: Array  # (M, L, 6) [rad]
    rates: Array  # (M, L, 6) [rad/s]
    points: tuple[Points, ...]  # of each module: (M, 8, 3), (M, 8, 3, 3)


def events(time: Array) -> list[tuple[int, int]]:
    """First and last sample of every stretch between events."""
    cuts = np.flatnonzero(np.diff(time) <= 0) + 1
    edges = [0, *cuts.tolist(), len(time)]
    return [(a, b - 1) for a, b in itertools.pairwise(edges) if b - a >= 2]


def hermite(time: Array, values: Array, rates: Array, at: Array) -> tuple[Array, Array]:
    """Cubic Hermite values and rates (M, ...) between samples."""
    k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    shape = (len(at),) + (1,) * (values.ndim - 1)
    h = (time[k + 1] - time[k]).reshape(shape)
    s = (at - time[k]).reshape(shape) / h
    a, b, da, db = values[k], values[k + 1], rates[k] * h, rates[k + 1] * h
    value = (
        (2 * s**3 - 3 * s**2 + 1) * a
        + (s**3 - 2 * s**2 + s) * da
        + (3 * s**2 - 2 * s**3) * b
        + (s**3 - s**2) * db
    )
    rate = (
        (6 * s**2 - 6 * s) * (a - b) + (3 * s**2 - 4 * s + 1) * da + (3 * s**2 - 2 * s) * db
    ) / h
    return value, rate


def fine_times(time: Array) -> Array:
    """The samples' times and those between them, at most `STEP` apart."""
    counts = np.maximum(np.ceil(np.diff(time) / STEP - 1e-9).astype(int), 1)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(time[:-1], time[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, time[-1:]])


def stretches(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Stretch]:
    """The motion at 1 ms, stretch by stretch."""
    motion = plan.motion
    for first, last in events(motion.time):
        span = slice(first, last + 1)
        time = motion.time[span]
        at = fine_times(time)
        box, velocity = hermite(time, motion.box_position[span], motion.box_velocity[span], at)
        yaw, turning = hermite(time, motion.box_yaw[span], motion.box_yaw_rate[span], at)
        angles, rates = hermite(time, motion.joint_angles[span], motion.joint_velocity[span], at)
        points: dict[int, Points] = {}
        for m in carriers_first(plan, first):
            root = _root(plan, m, first, span, time, at, (box, yaw), points)
            points[m] = placed(module, root.end, root.pose, angles[:, m])
        whole = tuple(points[m] for m in range(len(points)))
        yield Stretch(first, last, at, box, velocity, yaw, turning, angles, rates, whole)


def carriers_first(plan: LimmsPlan, sample: int) -> list[int]:
    """Modules in an order in which each comes after the one that carries it."""
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    ends = (plan.motion.base_anchor[sample], plan.motion.tip_anchor[sample])
    carried = {
        m: {(int(a[m]) - anchors) // 2 for a in ends if a[m] >= anchors} for m in range(count)
    }
    order: list[int] = []
    while len(order) < count:
        fit = [m for m in range(count) if m not in order and carried[m] <= {m, *order}]
        # A ring of modules breaks rule 9 or 10, which says so; here any order will do.
        order += fit or [m for m in range(count) if m not in order]
    return order


def anchor_pose(plan: LimmsPlan, anchor: int, end: int, box: Array, yaw: Array) -> Pose:
    """Where an end on an anchor is: (M, 3), (M, 3, 3), for box centres (M, B, 3), yaws (M, B)."""
    count = len(box)
    on_boxes = 4 * len(plan.box_size)
    normal = plan.anchor_normal[anchor]
    if anchor < on_boxes:
        b = anchor // 4
        frame = turned(yaw[:, b])
        position = box[:, b] + frame @ (normal * np.abs(normal @ plan.box_size[b]) / 2)
        return Pose(position, frame @ on_anchor(normal, end))
    position = np.tile(plan.motion.anchor_position[0, anchor], (count, 1))
    return Pose(position, np.broadcast_to(on_anchor(normal, end), (count, 3, 3)))


def _root(
    plan: LimmsPlan,
    m: int,
    first: int,
    span: slice,
    time: Array,
    at: Array,
    boxes: tuple[Array, Array],
    others: dict[int, Points],
) -> Root:
    """What one module hangs on: terrain, another module, a box, or the ground."""
    motion = plan.motion
    anchors = (int(motion.base_anchor[first, m]), int(motion.tip_anchor[first, m]))
    ground = int(motion.ground_end[first, m])
    on_boxes, count = 4 * len(plan.box_size), len(plan.anchor_names)
    ends = sorted((0, 1), key=lambda end: -1 if anchors[end] >= on_boxes else 1)
    held = next((end for end in ends if anchors[end] >= 0), None)
    if held is not None and anchors[held] < count:
        return Root(held, anchor_pose(plan, anchors[held], held, *boxes))
    if held is not None:
        parent, its_end = divmod(anchors[held] - count, 2)
        if parent in others:
            carrier = others[parent]
            rotation = on_end(carrier.rotation[:, 7 * its_end], its_end, held)
            return Root(held, Pose(carrier.position[:, 7 * its_end], rotation))
    end = max(ground, 0)
    path = motion.joint_position[span, m, 7 * end]
    position = np.stack([np.interp(at, time, path[:, i]) for i in range(3)], axis=-1)
    if ground >= 0:
        return Root(end, Pose(position, np.broadcast_to(is_on_ground(end), (len(at), 3, 3))))
    # In nobody's hands: as stored, between samples straight
    near = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
    return Root(end, Pose(position, motion.joint_rotation[span, m, 0][near]))
