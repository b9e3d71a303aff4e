"""What a plan of a robot with grippers holds beside that of one without.

S is K instants or T samples; world frame, forces and moments on the robot. Fingers are at +-(span /
2) axis from the grip's centre, which lies the gripper's length before the toe, against the surface.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class SpineModel:
    """The Gaussian process that spines were counted on by, eqs. (3.3) to (3.6), as arrays."""

    state: Array  # (n, 4) training inputs: orientation [rad], friction
    force: Array  # (n,) training outputs [N]
    center: Array  # (4,) of the inputs
    scale: Array  # (4,) of the inputs
    signal: float  # sigma_f [N]
    length: float  # l, on standardised inputs
    noise: float  # sigma_n [N]


@dataclass(frozen=True)
class GripForces:
    """What grippers do beside the contact force, zero for lifted limbs."""

    grip: Array  # (S, N) gripping force of each finger [N]
    palm: Array  # (S, N, 3) force of the surface on the palm [N]
    moment: Array  # (S, N, 3) of the surface on the gripper, about the grip's centre [N m]

    @property
    def packed_array(self) -> Array:
        """(S, N, 7) all of it, for what treats it alike."""
        return np.concatenate([self.grip[..., None], self.palm, self.moment], axis=-1)

    @classmethod
    def unpack(cls, packed: Array) -> GripForces:
        """Unpack the stored array (S, N, 7)."""
        return cls(packed[..., 0], packed[..., 1:4], packed[..., 4:7])


@dataclass(frozen=True)
class GripPlan:
    """Grips at the instants and on the way, and what the spines were counted on for."""

    risk: float  # that a grip holds less than was counted on
    model: SpineModel
    spines: Array  # (R,) shear force of a gripper's spines on each surface [N]
    instants: GripForces
    wrist_angles: Array  # (K, N, 3) [rad]
    wrist_torque: Array  # (K, N, 3) [N m]
    pull_margin: Array  # (K, N) further pull that a grip holds, infinite if any [N]
    trajectory: GripForces
    trajectory_force: Array  # (T, N, 3) contact forces on the way [N]
