"""Motion of one module while all else rests: its distances, and its stretch in a plan."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import forward, forward_from_last
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.limms_scene import FramePoses, Points


class Blocked(Exception):
    """No free motion was found; the message says for which module and target."""


def compute_gaps(
    partial_plan: PartialPlan, module: int, points: Points, root_end: int | None = None
) -> Array:
    """Return the least gap (n,) of a module's poses from solids, boxes, modules and itself [m].

    Args:
        partial_plan: Where everything else is.
        module: The module.
        points: Poses of the module (n).
        root_end: The fixed end; its link does not move, and touches what it stands on.
    """
    scene, radius = partial_plan.scene, partial_plan.scene.module.radius
    segments = link_segments(points, radius)
    lower, upper = scene.solids[:, 0], scene.solids[:, 1]
    moving = segments
    if root_end is not None:
        moving = segments[..., 1:, :, :] if root_end == 0 else segments[..., :3, :, :]
    distances = [
        gap_to_blocks(moving, lower, upper, radius).min(axis=(-1, -2)),
        gap_to_boxes(
            moving, partial_plan.centres, partial_plan.yaws, scene.box_size / 2, radius
        ).min(axis=(-1, -2)),
        gap_within(segments, radius).min(axis=-1),
    ]
    distances += [
        gap_between(moving, partial_plan.segments(second), radius).min(axis=(-1, -2))
        for second in range(scene.num_modules)
        if second != module
    ]
    smallest: Array = np.min(distances, axis=0)
    return smallest


def compute_rooted_points(
    partial_plan: PartialPlan, root: FramePoses, root_end: int, angles: Array
) -> Points:
    """Return the poses (n) of a module with one end fixed."""
    shape = angles.shape[:-1]
    base = FramePoses(
        np.broadcast_to(root.position, (*shape, 3)),
        np.broadcast_to(root.rotation, (*shape, 3, 3)),
    )
    kinematics = forward if root_end == 0 else forward_from_last
    return kinematics(partial_plan.scene.module, base, angles)


def add_motion(
    partial_plan: PartialPlan,
    module: int,
    points: Points,
    *,
    time: Array,
    angles: Array,
    rates: Array,
    name: str,
) -> None:
    """Add a stretch in which one module moves while all else rests."""
    moving = partial_plan.build_rest(name, time)
    moving.place(module, FramePoses(points.position[:, 0], points.rotation[:, 0]), angles, rates)
    partial_plan.add(moving)
