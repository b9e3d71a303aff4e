"""Kinematics of a module from the joint angles and the held end, independent of the planner.

Joints rotate about the module's axis (z) or across it (y), eq. (6.2), link after link from the held
end. Ends on anchors, on the ground and on one another have the frames of eq. (6.1).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import FramePoses, Points
from climbplan.limms.schema.module import ModuleSpec

_Y_AXIS, _Z_AXIS = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_AXES = (_Z_AXIS, _Y_AXIS, _Y_AXIS, _Z_AXIS, _Y_AXIS, _Z_AXIS)
_HALF_TURN = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix()  # rotation by pi about x


def compute_points(module: ModuleSpec, end: int, root: FramePoses, angles: Array) -> Points:
    """Return all points of modules whose end (0 first, 1 last) is at `root`.

    Args:
        module: The module.
        end: The held end.
        root: Its pose (...).
        angles: Joint angles (..., 6) [rad].
    """
    shape = angles.shape[:-1]
    joint_rotations = [
        Rotation.from_rotvec(np.outer(angles[..., k].ravel(), axis)).as_matrix()
        for k, axis in enumerate(_AXES)
    ]
    rotation = np.empty((*shape, 8, 3, 3))
    position = np.empty((*shape, 8, 3))
    root_point = 7 * end
    position[..., root_point, :], rotation[..., root_point, :, :] = root.position, root.rotation
    links = list(enumerate(module.link_lengths))
    for k, length in links if end == 0 else links[::-1]:
        rotation_of_joint = joint_rotations[k].reshape(*shape, 3, 3) if k < 6 else np.eye(3)
        # Link k follows the frame before joint k; the joint rotates the frame after it
        if end == 0:
            rotation[..., k + 1, :, :] = rotation[..., k, :, :] @ rotation_of_joint
            step = length * rotation[..., k, :, 2]
            position[..., k + 1, :] = position[..., k, :] + step
        else:
            rotation[..., k, :, :] = rotation[..., k + 1, :, :] @ np.swapaxes(
                rotation_of_joint, -1, -2
            )
            step = length * rotation[..., k, :, 2]
            position[..., k, :] = position[..., k + 1, :] - step
    return Points(position, rotation)


def compute_anchor_end_frame(normal: Array, end: int) -> Array:
    """Return the frame (3, 3) of an end on an anchor.

    Its z axis points away from the surface for a first end, into it for a last one. Its x axis
    points up, on level anchors along the world's x axis.
    """
    x = _Z_AXIS if abs(normal[2]) < 0.5 else np.array([1.0, 0.0, 0.0])
    frame = np.stack([x, np.cross(normal, x), normal], axis=1)
    return frame if end == 0 else frame @ _HALF_TURN


def compute_yaw_rotation(yaw: Array) -> Array:
    """Return the frames (..., 3, 3) of upright boxes by their yaws (...) [rad]."""
    rotation_vectors = np.outer(np.ravel(yaw), _Z_AXIS)
    frames: Array = Rotation.from_rotvec(rotation_vectors).as_matrix().reshape(*np.shape(yaw), 3, 3)
    return frames


def compute_ground_end_frame(end: int) -> Array:
    """Return the frame (3, 3) of an end that stands upright."""
    return np.eye(3) if end == 0 else _HALF_TURN


def compute_mated_end_frame(carrying: Array, carrying_end: int, end: int) -> Array:
    """Return the frame (..., 3, 3) of an end on another module's end.

    The end is in line with the carrying one, or face to face where both ends are of one kind.
    """
    return carrying @ _HALF_TURN if carrying_end == end else carrying
