"""What each link of a limb weighs, and where: as a limb moves, so does the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class LinkMasses:
    """Links of N chains of J joints, body frame, at zero angles; and what is left to the body.

    A link is all that moves with a joint; zero where a limb has no such joint.
    """

    mass: Array  # (N, J) [kg]
    middle: Array  # (N, J, 3) centre of mass from the link's joint [m]
    inertia: Array  # (N, J, 3, 3) about it [kg m^2]
    body_mass: float  # [kg]
    body_middle: Array  # (3,) from the body's origin [m]
    body_inertia: Array  # (3, 3) about it [kg m^2]

    @property
    def share(self) -> float:
        """Of the whole mass, in the links."""
        return float(self.mass.sum() / (self.mass.sum() + self.body_mass))

    def ordered(self, limbs: list[int]) -> Self:
        """The limbs of these numbers, in this order, on the same body."""
        own = self.mass[limbs], self.middle[limbs], self.inertia[limbs]
        return type(self)(*own, self.body_mass, self.body_middle, self.body_inertia)

    def middles(self, chain: SerialChain, angles: Array) -> Array:
        """Centres of mass of links (..., N, J, 3) at angles (..., N, J), body frame [m]."""
        pose = chain.pose(angles)
        return np.asarray(pose.places + (pose.turns @ self.middle[..., None])[..., 0])

    def centre(self, chain: SerialChain, angles: Array) -> Array:
        """Centre of mass of the robot (..., 3) at angles (..., N, J), body frame [m]."""
        moment = np.einsum("nj,...nji->...i", self.mass, self.middles(chain, angles))
        whole = self.mass.sum() + self.body_mass
        return np.asarray((moment + self.body_mass * self.body_middle) / whole)
