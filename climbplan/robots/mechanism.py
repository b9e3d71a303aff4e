"""The interface of all kinds of limbs, whatever their joints are.

A mechanism has the geometry of all N limbs of a robot in the body frame and nothing else: no
torques, bounds or masses. J is the number of joints of the limb that has most. A limb with fewer
begins with joints that move nothing and stay at zero (no name, a zero column in the Jacobian).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from climbplan.arrays import Array, BoolArray

BOUND_SLACK = 1e-9  # [rad] rounding at a joint bound is not a violation


@dataclass(frozen=True)
class InverseKinematics:
    """Joint angles for given toes, by branch (a closed form has several, a chain has one).

    Branches of a coxa-femur-tibia limb: 0 knee up, 1 knee down (coxa towards the toe); 2 and 3 with
    the coxa turned away. B is the number of branches.
    """

    angles: Array  # (..., B, N, J) [rad], wrapped into the joint bounds where possible
    reachable: BoolArray  # (..., B, N) the toe lies within the links' reach
    within_bounds: BoolArray  # (..., B, N) reachable and every joint within its bounds
    missing: Array  # (..., B, N) [m] distance by which the toe is out of reach, 0 if reachable
    tilted: Array | None = None  # (..., B, N) [rad] of a last link from its required rotation

    @property
    def valid(self) -> BoolArray:
        """Whether at least one branch is within the joint bounds, (..., N)."""
        return np.asarray(self.within_bounds.any(axis=-2))

    def best(self) -> Array:
        """Return the first branch within bounds of every limb, (..., N, J); NaN without one."""
        first = np.argmax(self.within_bounds, axis=-2)  # (..., N)
        selected = np.take_along_axis(self.angles, first[..., None, :, None], axis=-3)[..., 0, :, :]
        return np.where(self.valid[..., None], selected, np.nan)


@dataclass(frozen=True)
class Miss:
    """Why a limb does not reach a toe."""

    reason: str  # "too far", "femur 3.0 deg past its bound"
    missing: float  # [m] by which the toe is out of reach, 0 if only joint bounds fail
    joint: int | None = None  # that is past its bound, where one is known
    past: float = 0.0  # [rad] by which it is


class Mechanism(Protocol):
    """Kinematics of N limbs with up to J joints; all positions in the body frame [m]."""

    @property
    def joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of every limb's J joints, from the body to the toe; empty for none; N tuples."""

    def joint_points(self, angles: Array) -> Array:
        """Return first joint, further joints and toe (..., N, P, 3) for angles (..., N, J) [rad].

        Links are the straight pieces between them; the link after joint j moves with joint j.
        """

    def jacobian(self, angles: Array) -> Array:
        """Return d(toe)/d(angles) (..., N, 3, J) [m/rad] for angles (..., N, J)."""

    def hessian(self, angles: Array) -> Array:
        """Return second derivatives of the toe (..., N, 3, J, J) for angles (..., N, J)."""

    def turning(self, angles: Array) -> Array:
        """Return the angular velocity of the last link by joint speed, (..., N, 3, J).

        Of serial limbs its columns are the unit axes of the joints.
        """

    def last_link(self, angles: Array) -> Array:
        """Return rows (..., N, 3, 3): x along the last link, y across it, z its joint's axis.

        What is mounted at the toe counts its angles from there. NaN where the toe lies on that
        axis.
        """

    def inverse(self, toes: Array, lower: Array, upper: Array) -> InverseKinematics:
        """Return joint angles for toes (..., N, 3) and joint bounds (N, J) [rad].

        They are a function of each toe alone: the same toe has the same angles every time, and they
        are continuous along a path.
        """

    def explain_miss(
        self, solution: InverseKinematics, toes: Array, limb: int, lower: Array, upper: Array
    ) -> Miss:
        """Explain why limb `limb` of a solution for toes (N, 3) is not valid."""

    def only(self, limbs: slice) -> Self:
        """Return the mechanism of some limbs."""
