"""Where a box is: its centre, and its yaw where it turns.

A box stays upright, so that its attitude is one angle about the vertical. A placement (..., D) is
its centre [m], for D = 4 with the yaw [rad] after it; a box that does not turn has D = 3 and yaw 0.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array


def centre_of(place: Array) -> Array:
    """The centres (..., 3) of placements (..., D) [m]."""
    return place[..., :3]


def yaw_of(place: Array) -> Array:
    """The yaws (...) of placements (..., D) [rad]."""
    return place[..., 3] if place.shape[-1] == 4 else np.zeros(place.shape[:-1])


def upright(yaw: Array | float) -> Array:
    """Rotations (..., 3, 3) by yaws (...) about the vertical, box to world."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.zeros((*np.shape(yaw), 3, 3))
    turn[..., 0, 0], turn[..., 0, 1] = c, -s
    turn[..., 1, 0], turn[..., 1, 1] = s, c
    turn[..., 2, 2] = 1.0
    return turn


def in_world(yaw: Array | float, vectors: Array) -> Array:
    """Vectors (..., 3) of the box's frame in the world's."""
    turned: Array = (upright(yaw) @ vectors[..., None])[..., 0]
    return turned


def wrapped(angle: Array | float) -> Array:
    """Angles in [-pi, pi)."""
    return np.asarray((np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi)


def vertical_inertia(mass: float, size: Array) -> float:
    """Moment of inertia of a box (3,), as heavy all through, about the vertical [kg m^2]."""
    return float(mass * (size[0] ** 2 + size[1] ** 2) / 12)


def extents(half: Array, least: float, most: float) -> Array:
    """Half edges (3,) of the smallest upright block that a box (3,) stays in between two yaws."""
    # half_x |cos| + half_y |sin| is largest where a diagonal lies along the axis, or at the ends
    lean = float(np.arctan2(half[1], half[0]))
    diagonals = np.concatenate([_HALF_TURNS + lean, _HALF_TURNS - lean])
    found = []
    for axis in (0.0, np.pi / 2):
        peaks = diagonals + axis
        at = np.concatenate([[least, most], peaks[(peaks > least) & (peaks < most)]]) - axis
        found.append(float((half[0] * np.abs(np.cos(at)) + half[1] * np.abs(np.sin(at))).max()))
    return np.array([*found, half[2]])


_HALF_TURNS = np.pi * np.arange(-6, 7)
