"""Modules as arms and legs of the box: where their ends are, and which branch of the inverse."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import along, forward
from climbplan.limms.scene.limms_scene import FLIP, SIDE_NORMALS, Points, Pose, Scene, anchor_frame
from climbplan.limms.scene.phases import Limb
from climbplan.limms.scene.placement import centre_of, rotation_about_vertical, yaw_of

UPRIGHT = np.eye(3)


def end_rotation(normal: Array, end: int) -> Array:
    """Frame of an end (0 first, 1 last) on an anchor with this normal, eq. (6.1)."""
    frame = anchor_frame(normal)
    return frame if end == 0 else frame @ FLIP


def standing_rotation(end: int) -> Array:
    """Frame of an end that stands on the ground, the module upright above it."""
    return UPRIGHT if end == 0 else FLIP


def arm(
    module: int, side: int, root: Pose, box_end: int, branch: tuple[int, int, int] = (1, 1, 1)
) -> Limb:
    """An arm whose other end is fixed at `root`, with the frame that end has there."""
    return Limb(
        module=module,
        side=side,
        box_end=box_end,
        is_leg=False,
        fixed_position=root.position,
        other_rotation=root.rotation,
        box_rotation=end_rotation(SIDE_NORMALS[side], box_end),
        branch=branch,
    )


def leg(module: int, side: int, box_end: int, branch: tuple[int, int, int]) -> Limb:
    """A leg; its foot stands upright."""
    return Limb(
        module=module,
        side=side,
        box_end=box_end,
        is_leg=True,
        fixed_position=np.full(3, np.nan),
        other_rotation=standing_rotation(1 - box_end),
        box_rotation=end_rotation(SIDE_NORMALS[side], box_end),
        branch=branch,
    )


def root_on_anchor(scene: Scene, wall: int, end: int) -> Pose:
    """Pose of an end latched to anchor number `wall` of the terrain."""
    return Pose(scene.wall_position[wall], end_rotation(scene.wall_normal[wall], end))


def side_pose(scene: Scene, box: Array, side: int, end: int) -> Pose:
    """Pose of an end latched to a side of the box to deliver, which is placed at `box` (..., D)."""
    return _on_box(scene, box, side, end_rotation(SIDE_NORMALS[side], end))


def _on_box(scene: Scene, box: Array, side: int, rotation: Array) -> Pose:
    """An end on a side of the box; rotation: (3, 3) in the box's frame."""
    offset = scene.side_offset(0, side)
    if box.shape[-1] == 3:
        return Pose(box + offset, rotation)
    frame = rotation_about_vertical(yaw_of(box))
    return Pose(centre_of(box) + frame @ offset, frame @ rotation)


def limb_frames(scene: Scene, limb: Limb, box: Array, other: Array) -> tuple[Pose, Pose]:
    """First and last end of a limb for placements of the box (..., D), other ends (..., 3)."""
    on_box = _on_box(scene, box, limb.side, limb.box_rotation)
    far = Pose(np.broadcast_to(other, (*box.shape[:-1], 3)), limb.other_rotation)
    return (on_box, far) if limb.box_end == 0 else (far, on_box)


def limb_angles(
    scene: Scene, limb: Limb, box: Array, other: Array, branch: tuple[int, int, int]
) -> tuple[Array, Array]:
    """Angles (T, 6) along a path of placements of the box (T, D), and missing reach (T) [m]."""
    first, last = limb_frames(scene, limb, box, other)
    shape = (len(box), 3, 3)
    first = Pose(first.position, np.broadcast_to(first.rotation, shape))
    last = Pose(last.position, np.broadcast_to(last.rotation, shape))
    return along(scene.module, first, last, branch)


def limb_points(scene: Scene, limb: Limb, box: Array, other: Array, angles: Array) -> Points:
    """All points of a limb along a path."""
    first, _ = limb_frames(scene, limb, box, other)
    base = Pose(first.position, np.broadcast_to(first.rotation, (len(box), 3, 3)))
    return forward(scene.module, base, angles)
