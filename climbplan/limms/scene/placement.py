"""Placements of boxes: the centre, and the yaw of a box that turns.

A box stays upright, so its attitude is one angle about the vertical. A placement (..., D) is the
centre [m], for D = 4 followed by the yaw [rad]. A box that does not turn has D = 3 and yaw 0.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array


def centre_of(place: Array) -> Array:
    """Return the centres (..., 3) of placements (..., D) [m]."""
    return place[..., :3]


def yaw_of(place: Array) -> Array:
    """Return the yaws (...) of placements (..., D) [rad]."""
    return place[..., 3] if place.shape[-1] == 4 else np.zeros(place.shape[:-1])


def rotation_about_vertical(yaw: Array | float) -> Array:
    """Return rotations (..., 3, 3) by yaws (...) about the vertical, box frame to world frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.zeros((*np.shape(yaw), 3, 3))
    rotation[..., 0, 0], rotation[..., 0, 1] = c, -s
    rotation[..., 1, 0], rotation[..., 1, 1] = s, c
    rotation[..., 2, 2] = 1.0
    return rotation


def rotate_to_world(yaw: Array | float, vectors: Array) -> Array:
    """Return vectors (..., 3) of the box frame in the world frame."""
    rotated: Array = (rotation_about_vertical(yaw) @ vectors[..., None])[..., 0]
    return rotated


def wrap_angle(angle: Array | float) -> Array:
    """Return angles wrapped to [-pi, pi)."""
    return np.asarray((np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi)


def inertia_about_vertical(mass: float, size: Array) -> float:
    """Return the inertia of a homogeneous box of edges (3,) about the vertical [kg m^2]."""
    return float(mass * (size[0] ** 2 + size[1] ** 2) / 12)


def swept_half_extents(half: Array, min_yaw: float, max_yaw: float) -> Array:
    """Return half edges (3,) of the smallest upright block around a box between two yaws.

    Args:
        half: Half edges of the box (3,) [m].
        min_yaw: Lower end of the yaw interval [rad].
        max_yaw: Upper end of the yaw interval [rad].
    """
    # half_x |cos| + half_y |sin| is largest where a diagonal lies along the axis, or at the ends
    diagonal_angle = float(np.arctan2(half[1], half[0]))
    diagonals = np.concatenate([_HALF_TURNS + diagonal_angle, _HALF_TURNS - diagonal_angle])
    horizontal = []
    for axis in (0.0, np.pi / 2):
        peaks = diagonals + axis
        yaws = (
            np.concatenate([[min_yaw, max_yaw], peaks[(peaks > min_yaw) & (peaks < max_yaw)]])
            - axis
        )
        horizontal.append(
            float((half[0] * np.abs(np.cos(yaws)) + half[1] * np.abs(np.sin(yaws))).max())
        )
    return np.array([*horizontal, half[2]])


_HALF_TURNS = np.pi * np.arange(-6, 7)
