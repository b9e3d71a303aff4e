"""Modules as arms and legs of the box: frames of their ends, and their inverse kinematics.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import forward, inverse_along_path
from climbplan.limms.scene.limms_scene import (
    FLIP,
    SIDE_NORMALS,
    FramePoses,
    ModuleScene,
    Points,
    anchor_frame,
)
from climbplan.limms.scene.phases import SupportModule
from climbplan.limms.scene.placement import centre_of, rotation_about_vertical, yaw_of

UPRIGHT = np.eye(3)


def compute_end_rotation(normal: Array, end: int) -> Array:
    """Return the frame (3, 3) of an end (0 first, 1 last) on an anchor of a normal, eq. (6.1)."""
    frame = anchor_frame(normal)
    return frame if end == 0 else frame @ FLIP


def compute_standing_rotation(end: int) -> Array:
    """Return the frame (3, 3) of an end that stands on the ground, the module upright above it."""
    return UPRIGHT if end == 0 else FLIP


def build_arm(
    module: int, side: int, root: FramePoses, box_end: int, branch: tuple[int, int, int] = (1, 1, 1)
) -> SupportModule:
    """Return an arm whose far end is fixed at `root`, with the frame of that end."""
    return SupportModule(
        module=module,
        side=side,
        box_end=box_end,
        is_leg=False,
        fixed_position=root.position,
        other_rotation=root.rotation,
        box_rotation=compute_end_rotation(SIDE_NORMALS[side], box_end),
        branch=branch,
    )


def build_leg(module: int, side: int, box_end: int, branch: tuple[int, int, int]) -> SupportModule:
    """Return a leg whose foot stands upright."""
    return SupportModule(
        module=module,
        side=side,
        box_end=box_end,
        is_leg=True,
        fixed_position=np.full(3, np.nan),
        other_rotation=compute_standing_rotation(1 - box_end),
        box_rotation=compute_end_rotation(SIDE_NORMALS[side], box_end),
        branch=branch,
    )


def compute_anchor_pose(scene: ModuleScene, anchor: int, end: int) -> FramePoses:
    """Return the pose of an end latched to a terrain anchor, by its number among those."""
    return FramePoses(
        scene.wall_position[anchor], compute_end_rotation(scene.wall_normal[anchor], end)
    )


def compute_side_pose(scene: ModuleScene, box: Array, side: int, end: int) -> FramePoses:
    """Return the pose of an end latched to a side of the first box at placements (..., D)."""
    return _compute_pose_on_box(scene, box, side, compute_end_rotation(SIDE_NORMALS[side], end))


def _compute_pose_on_box(scene: ModuleScene, box: Array, side: int, rotation: Array) -> FramePoses:
    """Return the pose of an end on a side of the box; rotation: (3, 3) in the box frame."""
    offset = scene.side_offset(0, side)
    if box.shape[-1] == 3:
        return FramePoses(box + offset, rotation)
    frame = rotation_about_vertical(yaw_of(box))
    return FramePoses(centre_of(box) + frame @ offset, frame @ rotation)


def compute_limb_frames(
    scene: ModuleScene, limb: SupportModule, box: Array, far_end: Array
) -> tuple[FramePoses, FramePoses]:
    """Return first and last end of a limb for placements of the box (..., D).

    Args:
        scene: The scene.
        limb: The limb.
        box: Placements of the box (..., D) [m, rad].
        far_end: Positions of the end that is not on the box (..., 3) [m].
    """
    on_box = _compute_pose_on_box(scene, box, limb.side, limb.box_rotation)
    far_pose = FramePoses(np.broadcast_to(far_end, (*box.shape[:-1], 3)), limb.other_rotation)
    return (on_box, far_pose) if limb.box_end == 0 else (far_pose, on_box)


def compute_limb_angles(
    scene: ModuleScene,
    limb: SupportModule,
    box: Array,
    far_end: Array,
    branch: tuple[int, int, int],
) -> tuple[Array, Array]:
    """Return angles (T, 6) along a path of the box, and missing reach (T,) [m].

    Args:
        scene: The scene.
        limb: The limb.
        box: Placements of the box (T, D) [m, rad].
        far_end: Positions of the end that is not on the box (T, 3) [m].
        branch: Branch of the inverse kinematics.
    """
    first, last = compute_limb_frames(scene, limb, box, far_end)
    shape = (len(box), 3, 3)
    first = FramePoses(first.position, np.broadcast_to(first.rotation, shape))
    last = FramePoses(last.position, np.broadcast_to(last.rotation, shape))
    return inverse_along_path(scene.module, first, last, branch)


def compute_limb_points(
    scene: ModuleScene, limb: SupportModule, box: Array, far_end: Array, angles: Array
) -> Points:
    """Return all points of a limb along a path of the box.

    Args:
        scene: The scene.
        limb: The limb.
        box: Placements of the box (T, D) [m, rad].
        far_end: Positions of the end that is not on the box (T, 3) [m].
        angles: Joint angles (T, 6) [rad].
    """
    first, _ = compute_limb_frames(scene, limb, box, far_end)
    base = FramePoses(first.position, np.broadcast_to(first.rotation, (len(box), 3, 3)))
    return forward(scene.module, base, angles)
