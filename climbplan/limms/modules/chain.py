"""Kinematics of a module: roll, pitch, pitch, roll, pitch, roll (eq. (6.2)).

Angles are (..., 6) [rad], zero when straight. Point 0 is the first end, 1 to 6 the joints, 7 the
last end. The z axis of every frame points along the module, from the first end to the last. The
axes of joints 1 and 2 meet in the shoulder, those of joints 4, 5 and 6 in the wrist (joint 5). The
inverse kinematics is therefore closed-form with up to eight branches (Pieper 1968), labelled by the
signs of shoulder, elbow and wrist.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import FramePoses, Points
from climbplan.limms.schema.module import ModuleSpec

ROLLS = (True, False, False, True, False, True)
BRANCHES = tuple(product((1, -1), (1, -1), (1, -1)))
POINTS = 8


class IkSolution(NamedTuple):
    """Angles of one branch (..., 6), and how far the wrist is out of reach (...) [m]."""

    angles: Array
    reach_error: Array


def _joint_rotation(angles: Array, joint: int) -> Array:
    """Return the rotations (..., 3, 3) of one joint."""
    c, s = np.cos(angles[..., joint]), np.sin(angles[..., joint])
    zeros, ones = np.zeros_like(c), np.ones_like(c)
    if ROLLS[joint]:
        rows = [[c, -s, zeros], [s, c, zeros], [zeros, zeros, ones]]
    else:
        rows = [[c, zeros, s], [zeros, ones, zeros], [-s, zeros, c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def forward(module: ModuleSpec, base: FramePoses, angles: Array) -> Points:
    """Return all points of modules whose first ends are at `base`, eq. (6.2).

    Args:
        module: The module.
        base: Pose of the first end, broadcast over (...).
        angles: Joint angles (..., 6) [rad].
    """
    lengths = module.link_lengths
    shape = np.broadcast_shapes(angles.shape[:-1], base.position.shape[:-1])
    position = np.broadcast_to(base.position, (*shape, 3))
    rotation = np.broadcast_to(base.rotation, (*shape, 3, 3))
    positions, rotations = [position], [rotation]
    for joint in range(6):
        position = position + lengths[joint] * rotation[..., 2]
        rotation = rotation @ _joint_rotation(angles, joint)
        positions.append(position)
        rotations.append(rotation)
    positions.append(position + lengths[6] * rotation[..., 2])
    rotations.append(rotation)
    return Points(np.stack(positions, axis=-2), np.stack(rotations, axis=-3))


def forward_from_last(module: ModuleSpec, last: FramePoses, angles: Array) -> Points:
    """Return all points of modules whose last ends are at `last`.

    Args:
        module: The module.
        last: Pose of the last end (...).
        angles: Joint angles (..., 6) [rad].
    """
    shape = angles.shape[:-1]
    origin = FramePoses(np.zeros((*shape, 3)), np.broadcast_to(np.eye(3), (*shape, 3, 3)))
    points = forward(module, origin, angles)
    rotation = last.rotation @ np.swapaxes(points.rotation[..., 7, :, :], -1, -2)
    position = last.position - (rotation @ points.position[..., 7, :, None])[..., 0]
    return Points(
        position[..., None, :] + (rotation[..., None, :, :] @ points.position[..., None])[..., 0],
        rotation[..., None, :, :] @ points.rotation,
    )


def solve_inverse_kinematics(
    module: ModuleSpec, base: FramePoses, last: FramePoses, branch: tuple[int, int, int]
) -> IkSolution:
    """Return angles in (-pi, pi] that bring the last end to `last`, clipped where out of reach.

    Args:
        module: The module.
        base: Pose of the first end (...).
        last: Pose of the last end (...).
        branch: Signs of shoulder (forward, or over its back), elbow and wrist.
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
    # In the plane of the arm, pitch turns z towards x
    pitch = np.arctan2(reach, height) - np.arctan2(fore * np.sin(bend), upper + fore * np.cos(bend))
    angles = np.stack([yaw, pitch, bend], axis=-1)
    to_joint = to_base
    for joint in range(3):
        to_joint = np.swapaxes(_joint_rotation(angles, joint), -1, -2) @ to_joint
    remaining = to_joint @ last.rotation  # Rz(q4) Ry(q5) Rz(q6)
    bend5 = flip * np.arccos(np.clip(remaining[..., 2, 2], -1, 1))
    roll4 = np.arctan2(flip * remaining[..., 1, 2], flip * remaining[..., 0, 2])
    roll6 = np.arctan2(flip * remaining[..., 2, 1], -flip * remaining[..., 2, 0])
    wrapped_pitch = (pitch + np.pi) % (2 * np.pi) - np.pi
    excess = np.maximum(distance - (upper + fore), abs(upper - fore) - distance)
    return IkSolution(
        np.stack([yaw, wrapped_pitch, bend, roll4, bend5, roll6], axis=-1), np.maximum(excess, 0.0)
    )


def inverse_along_path(
    module: ModuleSpec, base: FramePoses, last: FramePoses, branch: tuple[int, int, int]
) -> IkSolution:
    """Return the inverse kinematics of a path of frames (T, ...), without jumps by full turns.

    Args:
        module: The module.
        base: Poses of the first end (T).
        last: Poses of the last end (T).
        branch: Signs of shoulder, elbow and wrist.
    """
    solution = solve_inverse_kinematics(module, base, last, branch)
    angles = np.unwrap(solution.angles, axis=0)
    limits = np.array(module.joint_range)
    # Full turns are chosen so that the path is in the middle of the range
    turn = np.round((angles.max(axis=0) + angles.min(axis=0)) / 2 / (2 * np.pi))
    angles = angles - np.where(limits > np.pi, turn, 0.0) * 2 * np.pi
    return IkSolution(angles, solution.reach_error)


def follow_path(
    module: ModuleSpec, first: FramePoses, last: FramePoses, start: Array
) -> IkSolution:
    """Return angles (T, 6) along a path of frames, each the nearest solution to the last one.

    Unlike `inverse_along_path`, the solution may pass through a pose where two branches meet.

    Args:
        module: The module.
        first: Poses of the first end (T).
        last: Poses of the last end (T).
        start: Angles from which the path continues (6,) [rad].
    """
    solutions = [solve_inverse_kinematics(module, first, last, branch) for branch in BRANCHES]
    turn = 2 * np.pi
    path, current = [], start
    for options in np.stack([solution.angles for solution in solutions], axis=1):
        options = options + np.round((current - options) / turn) * turn
        current = options[np.argmin(np.abs(options - current).max(axis=1))]
        path.append(current)
    return IkSolution(np.array(path), solutions[0].reach_error)


def range_excess(module: ModuleSpec, angles: Array, margin: float = 0.0) -> Array:
    """Return by how much the worst joint exceeds its range (...) [rad]; negative inside."""
    excess: Array = (np.abs(angles) - np.array(module.joint_range)).max(axis=-1) + margin
    return excess
