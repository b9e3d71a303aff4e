"""Where a module is, from the joint angles and the end that is held: the checker's own.

Joints turn about the module's axis (z) or across it (y), eq. (6.2), link after link from the held
end on. Ends on anchors, on the ground and on one another have the frames of eq. (6.1).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import Points, Pose
from climbplan.limms.schema.module import ModuleSpec

_ACROSS, _ALONG = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_AXES = (_ALONG, _ACROSS, _ACROSS, _ALONG, _ACROSS, _ALONG)
_OVER = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix()  # half a turn about x


def placed(module: ModuleSpec, end: int, held: Pose, angles: Array) -> Points:
    """All points of modules whose end (0 first, 1 last) is at `held`; angles (..., 6)."""
    shape = angles.shape[:-1]
    turns = [
        Rotation.from_rotvec(np.outer(angles[..., k].ravel(), axis)).as_matrix()
        for k, axis in enumerate(_AXES)
    ]
    rotation = np.empty((*shape, 8, 3, 3))
    position = np.empty((*shape, 8, 3))
    at = 7 * end
    position[..., at, :], rotation[..., at, :, :] = held.position, held.rotation
    links = list(enumerate(module.link_lengths))
    for k, length in links if end == 0 else links[::-1]:
        turn = turns[k].reshape(*shape, 3, 3) if k < 6 else np.eye(3)
        # Link k runs along the frame before joint k, which its end has turned by
        if end == 0:
            rotation[..., k + 1, :, :] = rotation[..., k, :, :] @ turn
            ahead = length * rotation[..., k, :, 2]
            position[..., k + 1, :] = position[..., k, :] + ahead
        else:
            rotation[..., k, :, :] = rotation[..., k + 1, :, :] @ np.swapaxes(turn, -1, -2)
            ahead = length * rotation[..., k, :, 2]
            position[..., k, :] = position[..., k + 1, :] - ahead
    return Points(position, rotation)


def on_anchor(normal: Array, end: int) -> Array:
    """Frame (3, 3) of an end on an anchor: its z axis away from the surface for a first end, into
    it for a last one; its x axis up, on level anchors the world's x."""
    x = _ALONG if abs(normal[2]) < 0.5 else np.array([1.0, 0.0, 0.0])
    frame = np.stack([x, np.cross(normal, x), normal], axis=1)
    return frame if end == 0 else frame @ _OVER


def turned(yaw: Array) -> Array:
    """Frames (..., 3, 3) of boxes that stand upright, by their yaws (...)."""
    flat = np.outer(np.ravel(yaw), _ALONG)
    frames: Array = Rotation.from_rotvec(flat).as_matrix().reshape(*np.shape(yaw), 3, 3)
    return frames


def is_on_ground(end: int) -> Array:
    """Frame (3, 3) of an end that stands upright."""
    return np.eye(3) if end == 0 else _OVER


def on_end(carrying: Array, its_end: int, end: int) -> Array:
    """Frame (..., 3, 3) of an end on another module's end of frame `carrying`: in line with it,
    or face to face where both are of a kind."""
    return carrying @ _OVER if its_end == end else carrying
