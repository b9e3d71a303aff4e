"""Kinematics of a module: roll, pitch, pitch, roll, pitch, roll (eq. (6.2)).

Angles are (..., 6) [rad], zero when straight. Point 0 is the first end, 1 to 6 the joints, 7 the
last end. The z axis of every frame points along the module, from the first end to the last. Axes of
joints 1 and 2 meet in the shoulder, those of joints 4, 5 and 6 in the wrist (joint 5), so that the
inverse is closed: up to eight solutions, told apart by the signs of shoulder, elbow and wrist.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import Points, Pose
from climbplan.limms.schema.module import ModuleSpec

ROLLS = (True, False, False, True, False, True)
BRANCHES = tuple(product((1, -1), (1, -1), (1, -1)))
POINTS = 8


class Solution(NamedTuple):
    """Angles of one branch (..., 6), and how far the wrist is out of reach (...) [m]."""

    angles: Array
    missing: Array


def _rotations(angles: Array, joint: int) -> Array:
    c, s = np.cos(angles[..., joint]), np.sin(angles[..., joint])
    zero, one = np.zeros_like(c), np.ones_like(c)
    if ROLLS[joint]:
        rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    else:
        rows = [[c, zero, s], [zero, one, zero], [-s, zero, c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def forward(module: ModuleSpec, base: Pose, angles: Array) -> Points:
    """All points of modules whose first ends are at `base`, eq. (6.2)."""
    lengths = module.link_lengths
    shape = np.broadcast_shapes(angles.shape[:-1], base.position.shape[:-1])
    position = np.broadcast_to(base.position, (*shape, 3))
    rotation = np.broadcast_to(base.rotation, (*shape, 3, 3))
    positions, rotations = [position], [rotation]
    for joint in range(6):
        position = position + lengths[joint] * rotation[..., 2]
        rotation = rotation @ _rotations(angles, joint)
        positions.append(position)
        rotations.append(rotation)
    positions.append(position + lengths[6] * rotation[..., 2])
    rotations.append(rotation)
    return Points(np.stack(positions, axis=-2), np.stack(rotations, axis=-3))


def from_last(module: ModuleSpec, last: Pose, angles: Array) -> Points:
    """All points of modules whose last ends are at `last`."""
    shape = angles.shape[:-1]
    origin = Pose(np.zeros((*shape, 3)), np.broadcast_to(np.eye(3), (*shape, 3, 3)))
    own = forward(module, origin, angles)
    rotation = last.rotation @ np.swapaxes(own.rotation[..., 7, :, :], -1, -2)
    position = last.position - (rotation @ own.position[..., 7, :, None])[..., 0]
    return Points(
        position[..., None, :] + (rotation[..., None, :, :] @ own.position[..., None])[..., 0],
        rotation[..., None, :, :] @ own.rotation,
    )


def inverse(module: ModuleSpec, base: Pose, last: Pose, branch: tuple[int, int, int]) -> Solution:
    """Angles in (-pi, pi] that bring the last end to `last`; clipped where it is out of reach.

    branch: signs of shoulder (reaching forward or over its back), elbow and wrist.
    """
    a = module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    to_base = np.swapaxes(base.rotation, -1, -2)
    wrist = last.position - (a[5] + a[6]) * last.rotation[..., 2]
    local = (to_base @ (wrist - base.position)[..., None])[..., 0]
    shoulder, elbow, flip = branch
    yaw = np.arctan2(shoulder * local[..., 1], shoulder * local[..., 0])
    reach = shoulder * np.hypot(local[..., 0], local[..., 1])
    height = local[..., 2] - a[0] - a[1]
    distance = np.hypot(reach, height)
    cosine = (distance**2 - upper**2 - fore**2) / (2 * upper * fore)
    bend = elbow * np.arccos(np.clip(cosine, -1, 1))
    # In the plane of the arm pitch turns z towards x.
    pitch = np.arctan2(reach, height) - np.arctan2(fore * np.sin(bend), upper + fore * np.cos(bend))
    angles = np.stack([yaw, pitch, bend], axis=-1)
    before = to_base
    for joint in range(3):
        before = np.swapaxes(_rotations(angles, joint), -1, -2) @ before
    left = before @ last.rotation  # Rz(q4) Ry(q5) Rz(q6)
    bend5 = flip * np.arccos(np.clip(left[..., 2, 2], -1, 1))
    roll4 = np.arctan2(flip * left[..., 1, 2], flip * left[..., 0, 2])
    roll6 = np.arctan2(flip * left[..., 2, 1], -flip * left[..., 2, 0])
    wrap_angle = (pitch + np.pi) % (2 * np.pi) - np.pi
    far = np.maximum(distance - (upper + fore), abs(upper - fore) - distance)
    return Solution(
        np.stack([yaw, wrap_angle, bend, roll4, bend5, roll6], axis=-1), np.maximum(far, 0.0)
    )


def along(module: ModuleSpec, base: Pose, last: Pose, branch: tuple[int, int, int]) -> Solution:
    """As `inverse` for a path of frames (T, ...): angles without jumps by full turns."""
    solution = inverse(module, base, last, branch)
    angles = np.unwrap(solution.angles, axis=0)
    limits = np.array(module.joint_range)
    # A whole turn more or less, whichever keeps to the middle of the range.
    turn = np.round((angles.max(axis=0) + angles.min(axis=0)) / 2 / (2 * np.pi))
    angles = angles - np.where(limits > np.pi, turn, 0.0) * 2 * np.pi
    return Solution(angles, solution.missing)


def continued(module: ModuleSpec, first: Pose, last: Pose, begin: Array) -> Solution:
    """Angles (T, 6) along a path of frames, each the nearest to the one before, from `begin`.

    Unlike `along` it may pass straight through a pose where two branches meet.
    """
    every = [inverse(module, first, last, branch) for branch in BRANCHES]
    turn = 2 * np.pi
    found, now = [], begin
    for options in np.stack([solution.angles for solution in every], axis=1):
        options = options + np.round((now - options) / turn) * turn
        now = options[np.argmin(np.abs(options - now).max(axis=1))]
        found.append(now)
    return Solution(np.array(found), every[0].missing)


def in_range(module: ModuleSpec, angles: Array, margin: float = 0.0) -> Array:
    """By how much the worst joint exceeds its range (...) [rad]; negative inside."""
    excess: Array = (np.abs(angles) - np.array(module.joint_range)).max(axis=-1) + margin
    return excess
