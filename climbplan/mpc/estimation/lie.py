"""Rotations as exponentials: what a filter on poses needs."""

from __future__ import annotations

import numpy as np

from climbplan.mpc.task import Array

_SMALL = 1e-6  # [rad] below which series of two terms are exact in double precision


def cross_matrix(vector: Array) -> Array:
    """The matrix (3, 3) of the cross product with one vector (3,)."""
    x, y, z = vector.tolist()  # four times as fast as on stacks of vectors
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(phi: Array) -> Array:
    """The rotation (3, 3) by a rotation vector (3,) [rad], Rodrigues' formula."""
    angle = float(np.sqrt(phi @ phi))
    K = cross_matrix(phi)
    if angle < _SMALL:
        return np.asarray(np.eye(3) + K + 0.5 * K @ K)
    first, second = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + first * K + second * K @ K)


def logarithm(rotation: Array) -> Array:
    """The rotation vector (3,) [rad] of a rotation (3, 3), shorter than pi."""
    sine = 0.5 * np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    length = float(np.sqrt(sine @ sine))
    angle = float(np.arctan2(length, 0.5 * (np.trace(rotation) - 1)))
    if length > _SMALL:
        return np.asarray(angle / length * sine)
    if angle < 1.0:
        return sine
    # Nearly half a turn: the axis is the largest column of R + I.
    column = (rotation + np.eye(3))[:, int(np.argmax(np.diag(rotation)))]
    return np.asarray(angle * column / np.linalg.norm(column))


def left_jacobian(phi: Array) -> Array:
    """J (3, 3) with Exp(phi + d) = Exp(J d) Exp(phi) to first order."""
    angle = float(np.sqrt(phi @ phi))
    K = cross_matrix(phi)
    if angle < _SMALL:
        return np.asarray(np.eye(3) + 0.5 * K + K @ K / 6)
    first = (1 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * K + second * K @ K)


def euler(rotation: Array) -> Array:
    """Roll, pitch, yaw (3,) [rad] of a body-to-world rotation (3, 3), Z-Y-X."""
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1.0, 1.0))
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])
