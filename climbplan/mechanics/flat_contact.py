"""A flat foot on its surface: what forces at the corners of its sole make together.

Forces at the corners, each in the friction cone of its surface, are all that a rectangle holds
which is pressed on anywhere: every pressure can be moved to the corners without a change of force
and centre of pressure. Of shear that turns on the spot they hold no less than pressure spread over
the sole does, as corners are farthest from its middle: a sole that is pressed evenly all over holds
less yaw moment than this.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import CORNERS, Sole


def moment_of(sole: Sole, normal: Array, corner_force: Array) -> Array:
    """Moment about the middle of soles (..., 3) [N m] of forces at their corners (..., 4, 3) [N].

    normal: (..., 3) unit, of the surfaces. World frame.
    """
    return np.asarray(np.cross(sole.arms(normal), corner_force).sum(axis=-2))


def spread_to_corners(force: Array, margin: float) -> Array:
    """Forces (..., 4, 3) at corners that do what forces at points inside them do.

    The points are corners of a sole that is smaller by a part `margin`. Forces stay in their cones.
    """
    near, far = 1.0 - margin / 2, margin / 2
    rows = [
        [(near if a[0] == b[0] else far) * (near if a[1] == b[1] else far) for b in CORNERS]
        for a in CORNERS
    ]
    return np.asarray(np.array(rows) @ force)


def centre_of_pressure(sole: Sole, normal: Array, force: Array, moment: Array) -> Array:
    """(..., 2) across and along soles from their middles [m]; NaN without pressure.

    force, moment: (..., 3) on the robot, about the middles; world frame.
    """
    axes = sole.axes(normal)
    turning = np.einsum("...ji,...j->...i", axes, moment)  # about across, along
    pressure = np.einsum("...j,...j->...", normal, force)
    safe = np.where(pressure > 0, pressure, np.nan)
    return np.stack([-turning[..., 1], turning[..., 0]], axis=-1) / safe[..., None]


def beyond_sole(sole: Sole, centre: Array) -> Array:
    """(...) how far centres of pressure (..., 2) lie beyond the edges [m], below zero inside."""
    return np.asarray((np.abs(centre) - sole.half_size).max(axis=-1))
