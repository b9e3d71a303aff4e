"""Masses of the links of limbs: the centre of mass moves with the limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.chain_pose import ChainPose
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class LinkMasses:
    """Links of N chains of J joints, body frame, at zero angles; and the remaining body.

    A link is all that moves with a joint; zero where a limb has no such joint.
    """

    mass: Array  # (N, J) [kg]
    middle: Array  # (N, J, 3) centre of mass from the link's joint [m]
    inertia: Array  # (N, J, 3, 3) about it [kg m^2]
    body_mass: float  # [kg]
    body_middle: Array  # (3,) from the body's origin [m]
    body_inertia: Array  # (3, 3) about it [kg m^2]

    @property
    def mass_fraction(self) -> float:
        """The fraction of the mass that is in the links."""
        return float(self.mass.sum() / (self.mass.sum() + self.body_mass))

    def middles(self, chain: SerialChain, angles: Array) -> Array:
        """Return centres of mass of links (..., N, J, 3) at angles (..., N, J), body frame [m]."""
        pose = chain.pose(angles)
        return np.asarray(pose.places + (pose.turns @ self.middle[..., None])[..., 0])

    def torques(self, chain: SerialChain, angles: Array, down: Array) -> Array:
        """Return torques (..., N, J) of the links' weight about their joints, as J^T f [N m, N].

        down: (..., 3) gravity in the body frame [m/s^2].
        """
        weight = self.mass[..., None] * down[..., None, None, :]
        return weight_torques(chain.pose(angles), self.middles(chain, angles), weight)

    def centre(self, chain: SerialChain, angles: Array) -> Array:
        """Return the centre of mass of the robot (..., 3) at angles (..., N, J), body frame [m]."""
        moment = np.einsum("nj,...nji->...i", self.mass, self.middles(chain, angles))
        whole = self.mass.sum() + self.body_mass
        return np.asarray((moment + self.body_mass * self.body_middle) / whole)


def weight_torques(
    pose: ChainPose, middles: Array, weight: Array, couple: Array | None = None
) -> Array:
    """Return torques (..., N, J) of forces on links about the joints that carry them [N m, or N].

    Args:
        pose: The chains.
        middles: Points (..., N, J, 3) at which the forces act, body frame [m].
        weight: Forces (..., N, J, 3), body frame [N].
        couple: Moments (..., N, J, 3) in addition, body frame [N m]; None for none.
    """
    # Power of the weight of link l by joint j <= l: axis . (arm x weight), or slide . weight
    arms = middles[..., None, :, :] - pose.joints[..., :, None, :]  # (..., N, joint, link, 3)
    moment = np.cross(arms, weight[..., None, :, :])
    if couple is not None:
        moment = moment + couple[..., None, :, :]
    power = np.einsum("...ji,...jli->...jl", pose.axes, moment)
    if pose.slides is not None:
        power += np.einsum("...ji,...li->...jl", pose.slides, weight)
    by_joint = np.triu(power).sum(axis=-1)  # links from the joint outward
    if pose.drive is None:
        return np.asarray(by_joint)
    return np.asarray((np.swapaxes(pose.drive, -1, -2) @ by_joint[..., None])[..., 0])
