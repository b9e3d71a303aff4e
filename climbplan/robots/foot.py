"""Feet of finite size: where a limb touches its surface, seen from its toe.

The toe of a limb is the point that its kinematics place. A spherical foot has the toe in its centre
and touches a surface of unit normal n, into free space, at toe - radius n. The contact force acts
there, as a force at that point of the last link. The contact rolls: when the last link turns, the
point of it that touches stands still, which that point's Jacobian says, to first order. Point toes
are spheres of radius zero.

A flat foot has the toe in the middle of its sole, a rectangle that lies on the surface. Every
pressure on it has the force and moment of forces at its four corners, and friction at the corners
is friction of the rectangle. The contact is therefore those four points of one link. A standing
foot does not turn: all of its six degrees of freedom are fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import turn_between

CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # across, along


@dataclass(frozen=True)
class Sole:
    """Flat feet: rectangles under the last links of N limbs.

    On level ground their length points where the body does as the task starts (`heading`). On other
    surfaces they are rotated by the smallest rotation from the vertical to the normal.
    """

    length: float  # [m] along
    width: float  # [m] across
    axes_zero: Array  # (N, 3, 3) columns across, along, normal of soles at zero angles, body frame
    heading: float = 0.0  # [rad] about z from the world's y

    @property
    def level_turns(self) -> Array:
        """Rotations (N, 3, 3) of last links from zero angles, soles level under a level body."""
        return np.asarray(np.swapaxes(self.axes_zero, -1, -2))

    @property
    def half_size(self) -> Array:
        """Half extents across and along (2,) [m]."""
        return np.array([self.width, self.length]) / 2

    @property
    def corners(self) -> Array:
        """Corners (4, 2) across and along, from the middle, in order [m]."""
        return np.asarray(CORNERS * self.half_size)

    def axes(self, normal: Array) -> Array:
        """Return columns across, along, normal (..., 3, 3) of soles on a surface, world frame.

        normal: (..., 3) unit.
        """
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        level = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turn_between(np.array([0.0, 0.0, 1.0]), normal) @ level)

    def arms(self, normal: Array) -> Array:
        """Return vectors from the toe to the corners (..., 4, 3) [m].

        normal: (..., 3) unit, of the surfaces.
        """
        return np.asarray(self.corners @ np.swapaxes(self.axes(normal)[..., :2], -1, -2))

    def within(self, margin: float) -> Self:
        """Return soles that are shorter and narrower by the fraction `margin`."""
        fraction = 1.0 - margin
        return replace(self, length=fraction * self.length, width=fraction * self.width)

    def only(self, limbs: slice) -> Self:
        """Return the soles of some limbs."""
        return replace(self, axes_zero=self.axes_zero[limbs])


@dataclass(frozen=True)
class Foot:
    """Feet of one kind and size on every limb."""

    radius: float = 0.0  # [m] of spheres about the toes
    sole: Sole | None = None  # of flat feet, which have no radius

    @property
    def points(self) -> int:
        """The number of points at which forces act on a standing limb."""
        return 1 if self.sole is None else len(CORNERS)

    def arm(self, normal: Array) -> Array:
        """Return vectors from the toe to where it touches (..., 3) [m], for unit normals (..., 3).

        A flat foot touches at the middle of its sole: the toe.
        """
        return -self.radius * normal

    def point_arms(self, normal: Array) -> Array:
        """Return vectors from the toe to each contact point (..., `points`, 3) [m].

        normal: (..., 3) unit, of the surfaces.
        """
        if self.sole is None:
            return self.arm(normal)[..., None, :]
        return self.sole.arms(normal)

    def only(self, limbs: slice) -> Self:
        """Return the feet of some limbs."""
        return self if self.sole is None else replace(self, sole=self.sole.only(limbs))
