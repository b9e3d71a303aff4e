"""Flat feet on surfaces: the combined effect of forces at the corners of a sole.

Forces at the corners, each in the friction cone of its surface, generate every wrench of pressure
on a rectangle: pressure can be moved to the corners without a change of force and centre of
pressure. They hold at least as much yaw moment as pressure spread over the sole, as corners are
farthest from its middle: an evenly pressed sole holds less.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import CORNERS, Sole


def moment_of(sole: Sole, normal: Array, corner_force: Array) -> Array:
    """Return the moment about the middle of soles (..., 3) [N m] of forces at their corners.

    Args:
        sole: The soles.
        normal: Unit normals (..., 3) of the surfaces, world frame.
        corner_force: (..., 4, 3) [N].
    """
    return np.asarray(np.cross(sole.arms(normal), corner_force).sum(axis=-2))


def spread_to_corners(force: Array, margin: float) -> Array:
    """Return forces (..., 4, 3) at corners that are equivalent to forces at points inside them.

    The points are corners of a sole that is smaller by the fraction `margin`. Forces stay in their
    cones.
    """
    near_weight, far_weight = 1.0 - margin / 2, margin / 2
    rows = [
        [
            (near_weight if a[0] == b[0] else far_weight)
            * (near_weight if a[1] == b[1] else far_weight)
            for b in CORNERS
        ]
        for a in CORNERS
    ]
    return np.asarray(np.array(rows) @ force)


def centre_of_pressure(sole: Sole, normal: Array, force: Array, moment: Array) -> Array:
    """Return the centre of pressure (..., 2) across and along soles from their middles [m].

    NaN without pressure. force, moment: (..., 3) on the robot, about the middles; world frame.
    """
    axes = sole.axes(normal)
    turning = np.einsum("...ji,...j->...i", axes, moment)  # about across, along
    pressure = np.einsum("...j,...j->...", normal, force)
    safe = np.where(pressure > 0, pressure, np.nan)
    return np.stack([-turning[..., 1], turning[..., 0]], axis=-1) / safe[..., None]


def beyond_sole(sole: Sole, centre: Array) -> Array:
    """Return how far centres of pressure (..., 2) lie beyond the edges [m], negative inside."""
    return np.asarray((np.abs(centre) - sole.half_size).max(axis=-1))
