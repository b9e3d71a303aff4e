"""One module that moves while all else rests: what is in its way, and its motion in a plan."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import forward, from_last
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.limms_scene import Points, Pose


class Blocked(Exception):
    """No free way was found; says for whom and where to."""


def gaps(world: PartialPlan, module: int, points: Points, root_end: int | None = None) -> Array:
    """Least gap (n) of a module's poses from solids, boxes, other modules and itself [m].

    root_end: the end that is fixed; its link does not move, and touches what it stands on.
    """
    scene, radius = world.scene, world.scene.module.radius
    segments = link_segments(points, radius)
    lower, upper = scene.solids[:, 0], scene.solids[:, 1]
    moving = segments
    if root_end is not None:
        moving = segments[..., 1:, :, :] if root_end == 0 else segments[..., :3, :, :]
    found = [
        gap_to_blocks(moving, lower, upper, radius).min(axis=(-1, -2)),
        gap_to_boxes(moving, world.centres, world.yaws, scene.box_size / 2, radius).min(
            axis=(-1, -2)
        ),
        gap_within(segments, radius).min(axis=-1),
    ]
    found += [
        gap_between(moving, world.segments(other), radius).min(axis=(-1, -2))
        for other in range(scene.num_modules)
        if other != module
    ]
    worst: Array = np.min(found, axis=0)
    return worst


def rooted(world: PartialPlan, root: Pose, root_end: int, angles: Array) -> Points:
    """Poses (n) of a module with one end fixed."""
    shape = angles.shape[:-1]
    base = Pose(
        np.broadcast_to(root.position, (*shape, 3)),
        np.broadcast_to(root.rotation, (*shape, 3, 3)),
    )
    place = forward if root_end == 0 else from_last
    return place(world.scene.module, base, angles)


def add_motion(
    world: PartialPlan,
    module: int,
    points: Points,
    time: Array,
    angles: Array,
    rates: Array,
    name: str,
) -> None:
    """Add a motion of one module while all else rests."""
    moving = world.rest(name, time)
    moving.place(module, Pose(points.position[:, 0], points.rotation[:, 0]), angles, rates)
    world.add(moving)
