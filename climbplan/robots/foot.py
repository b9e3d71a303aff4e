"""Feet of finite size: where a limb touches its surface, seen from its toe.

The toe of a limb is the point that its kinematics place. A spherical foot has the toe in its centre
and touches a surface of unit normal n, into free space, at toe - radius n: there the contact force
acts, and pushes whatever the joints do as a force at that point of the last link. A contact rolls:
when the last link turns, the point of it that touches stands still, which is what that point's
Jacobian says, to first order. Point toes are spheres of radius zero.

A flat foot has the toe in the middle of its sole, a rectangle that lies on the surface. Every
pressure on it makes the force and moment that forces at its four corners make, and friction at the
corners is friction of the rectangle: the contact is those four points of one link, whose force and
moment about the toe are theirs together. What stands does not turn: of the foot all six degrees of
freedom are held.
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

    They lie as a foot on level ground does whose length points where the body does as the task
    starts (`heading`), turned with the surface by the least turn that takes level ground to it.
    """

    length: float  # [m] along
    width: float  # [m] across
    axes_zero: Array  # (N, 3, 3) columns across, along, normal of soles at zero angles, body frame
    heading: float = 0.0  # [rad] about z from the world's y

    @property
    def level_turns(self) -> Array:
        """(N, 3, 3) of last links from zero angles, soles level under a body that is level."""
        return np.asarray(np.swapaxes(self.axes_zero, -1, -2))

    @property
    def half_size(self) -> Array:
        """(2,) half extents across and along [m]."""
        return np.array([self.width, self.length]) / 2

    @property
    def corners(self) -> Array:
        """(4, 2) across and along, from the middle, in turn [m]."""
        return np.asarray(CORNERS * self.half_size)

    def axes(self, normal: Array) -> Array:
        """Columns across, along, normal (..., 3, 3) of soles on surfaces of unit normals (..., 3).

        World frame.
        """
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        level = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turn_between(np.array([0.0, 0.0, 1.0]), normal) @ level)

    def arms(self, normal: Array) -> Array:
        """From the toe to the corners (..., 4, 3) [m], of soles on surfaces of normals (..., 3)."""
        return np.asarray(self.corners @ np.swapaxes(self.axes(normal)[..., :2], -1, -2))

    def within(self, margin: float) -> Self:
        """The same soles, shorter and narrower by a part of what they are."""
        part = 1.0 - margin
        return replace(self, length=part * self.length, width=part * self.width)

    def only(self, limbs: slice) -> Self:
        """Those of some limbs."""
        return replace(self, axes_zero=self.axes_zero[limbs])


@dataclass(frozen=True)
class Foot:
    """Feet of one kind and size on every limb."""

    radius: float = 0.0  # [m] of spheres about the toes
    sole: Sole | None = None  # of flat feet, which have no radius

    @property
    def points(self) -> int:
        """At how many points a limb that stands is pushed."""
        return 1 if self.sole is None else len(CORNERS)

    def arm(self, normal: Array) -> Array:
        """From the toe to where it touches (..., 3) [m], for unit normals (..., 3).

        Of a flat foot to the middle of its sole: the toe.
        """
        return -self.radius * normal

    def point_arms(self, normal: Array) -> Array:
        """From the toe to each point that is pushed (..., `points`, 3) [m], likewise."""
        if self.sole is None:
            return self.arm(normal)[..., None, :]
        return self.sole.arms(normal)

    def only(self, limbs: slice) -> Self:
        """Those of some limbs."""
        return self if self.sole is None else replace(self, sole=self.sole.only(limbs))
