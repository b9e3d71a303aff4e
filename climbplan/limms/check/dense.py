"""The motion between samples: everything recomputed at 1 ms from the samples."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.kinematics import (
    compute_anchor_end_frame,
    compute_ground_end_frame,
    compute_mated_end_frame,
    compute_points,
    compute_yaw_rotation,
)
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import FramePoses, Points
from climbplan.limms.schema.module import ModuleSpec

STEP = 1e-3  # [s]


class HeldRoot(NamedTuple):
    """The held end of a module, and its pose (M, 3), (M, 3, 3)."""

    end: int
    pose: FramePoses


@dataclass(frozen=True)
class DenseStretch:
    """Samples [first, last] without an event between, and M finer times."""

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


def find_events(time: Array) -> list[tuple[int, int]]:
    """Return first and last sample of every stretch between events."""
    cuts = np.flatnonzero(np.diff(time) <= 0) + 1
    edges = [0, *cuts.tolist(), len(time)]
    return [(a, b - 1) for a, b in itertools.pairwise(edges) if b - a >= 2]


def interpolate_hermite(
    time: Array, values: Array, rates: Array, times: Array
) -> tuple[Array, Array]:
    """Return cubic Hermite values and rates (M, ...) between samples."""
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    shape = (len(times),) + (1,) * (values.ndim - 1)
    h = (time[k + 1] - time[k]).reshape(shape)
    s = (times - time[k]).reshape(shape) / h
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


def refine_times(time: Array) -> Array:
    """Return the times of samples and times between them, at most `STEP` apart [s]."""
    counts = np.maximum(np.ceil(np.diff(time) / STEP - 1e-9).astype(int), 1)
    pieces = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(time[:-1], time[1:], counts, strict=True)
    ]
    return np.concatenate([*pieces, time[-1:]])


def iterate_stretches(plan: LimmsPlan, module: ModuleSpec) -> Iterator[DenseStretch]:
    """Yield the motion at 1 ms, stretch by stretch."""
    motion = plan.motion
    for first, last in find_events(motion.time):
        span = slice(first, last + 1)
        time = motion.time[span]
        times = refine_times(time)
        box, velocity = interpolate_hermite(
            time, motion.box_position[span], motion.box_velocity[span], times
        )
        yaw, yaw_rate = interpolate_hermite(
            time, motion.box_yaw[span], motion.box_yaw_rate[span], times
        )
        angles, rates = interpolate_hermite(
            time, motion.joint_angles[span], motion.joint_velocity[span], times
        )
        points: dict[int, Points] = {}
        for m in order_carriers_first(plan, first):
            root = _find_root(
                plan,
                m,
                first,
                span,
                time=time,
                times=times,
                placements=(box, yaw),
                placed_modules=points,
            )
            points[m] = compute_points(module, root.end, root.pose, angles[:, m])
        all_points = tuple(points[m] for m in range(len(points)))
        yield DenseStretch(
            first, last, times, box, velocity, yaw, yaw_rate, angles, rates, all_points
        )


def order_carriers_first(plan: LimmsPlan, sample: int) -> list[int]:
    """Return modules in an order in which each follows the one that carries it."""
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    ends = (plan.motion.base_anchor[sample], plan.motion.tip_anchor[sample])
    carried = {
        m: {(int(a[m]) - anchors) // 2 for a in ends if a[m] >= anchors} for m in range(count)
    }
    order: list[int] = []
    while len(order) < count:
        ready = [m for m in range(count) if m not in order and carried[m] <= {m, *order}]
        # A ring of modules violates rule 9 or 10; any order is as good
        order += ready or [m for m in range(count) if m not in order]
    return order


def compute_anchor_pose(
    plan: LimmsPlan, anchor: int, end: int, box: Array, yaw: Array
) -> FramePoses:
    """Return the pose (M, 3), (M, 3, 3) of an end on an anchor.

    Args:
        plan: The plan.
        anchor: The anchor.
        end: The end, 0 first or 1 last.
        box: Centres of the boxes (M, B, 3) [m].
        yaw: Yaws of the boxes (M, B) [rad].
    """
    count = len(box)
    on_boxes = 4 * len(plan.box_size)
    normal = plan.anchor_normal[anchor]
    if anchor < on_boxes:
        b = anchor // 4
        frame = compute_yaw_rotation(yaw[:, b])
        position = box[:, b] + frame @ (normal * np.abs(normal @ plan.box_size[b]) / 2)
        return FramePoses(position, frame @ compute_anchor_end_frame(normal, end))
    position = np.tile(plan.motion.anchor_position[0, anchor], (count, 1))
    return FramePoses(
        position, np.broadcast_to(compute_anchor_end_frame(normal, end), (count, 3, 3))
    )


def _find_root(
    plan: LimmsPlan,
    m: int,
    first: int,
    span: slice,
    *,
    time: Array,
    times: Array,
    placements: tuple[Array, Array],
    placed_modules: dict[int, Points],
) -> HeldRoot:
    """Return what a module is attached to: terrain, another module, a box, or the ground."""
    motion = plan.motion
    anchors = (int(motion.base_anchor[first, m]), int(motion.tip_anchor[first, m]))
    ground = int(motion.ground_end[first, m])
    on_boxes, count = 4 * len(plan.box_size), len(plan.anchor_names)
    ends = sorted((0, 1), key=lambda end: -1 if anchors[end] >= on_boxes else 1)
    held_end = next((end for end in ends if anchors[end] >= 0), None)
    if held_end is not None and anchors[held_end] < count:
        return HeldRoot(
            held_end, compute_anchor_pose(plan, anchors[held_end], held_end, *placements)
        )
    if held_end is not None:
        parent, parent_end = divmod(anchors[held_end] - count, 2)
        if parent in placed_modules:
            carrier = placed_modules[parent]
            rotation = compute_mated_end_frame(
                carrier.rotation[:, 7 * parent_end], parent_end, held_end
            )
            return HeldRoot(held_end, FramePoses(carrier.position[:, 7 * parent_end], rotation))
    end = max(ground, 0)
    path = motion.joint_position[span, m, 7 * end]
    position = np.stack([np.interp(times, time, path[:, i]) for i in range(3)], axis=-1)
    if ground >= 0:
        return HeldRoot(
            end,
            FramePoses(
                position, np.broadcast_to(compute_ground_end_frame(end), (len(times), 3, 3))
            ),
        )
    # Without a contact the stored pose is interpolated
    nearest = np.clip(np.searchsorted(time, times), 0, len(time) - 1)
    return HeldRoot(end, FramePoses(position, motion.joint_rotation[span, m, 0][nearest]))
