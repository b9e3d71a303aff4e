"""The interface of limbs in optimisation programs, for all mechanisms.

A program has the toes of N limbs as expressions in the body frame. It needs joint angles there,
torques of forces, and where toes would be with joints elsewhere. A mechanism with closed-form
inverse kinematics has functions of the toes (`symbolic_closed_form.py`). Others have angles as
variables of the program and rows that tie them to the toes (`symbolic_chains.py`). Matrices have
one column a limb. The structure of a program is hashable; everything else is a number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from climbplan.arrays import Array
from climbplan.robots.model import Robot

Shapes = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Tie:
    """Rows that hold where a limb stands at its toe; missing bounds are given with the data."""

    name: str
    rows: Any  # (r, N)
    unit: str
    lower: float | None = None
    upper: float | None = None


class StandingLimbs(Protocol):
    """N limbs with their toes at given points."""

    @property
    def angles(self) -> Any:
        """Joint angles (J, N) [rad]."""

    def ties(self, margin: float) -> list[Tie]:
        """Return the rows that hold for toes in reach.

        margin: off full stretch, of a cosine.
        """

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Return joint torques (J, N) of forces and moments (3, N) at the toes, body frame."""

    def centre(self) -> Any:
        """Return the robot's centre of mass (3, 1), body frame [m]; None if limbs weigh nothing."""

    def weight_torques(self, down: Any) -> Any:
        """Return joint torques (J, N) of the links' weight, over the weight of the robot [m].

        down: direction of gravity (3, 1), body frame. None where limbs weigh nothing.
        """

    def free_toes(self, deflection: Any) -> Any:
        """Return toes (3, N) in free space, body frame, with joints back by `deflection` (J, N)."""


class SymbolicLimbs(Protocol):
    """N limbs with J joints each, as programs are built for."""

    @property
    def limbs(self) -> int:
        """The number of limbs N."""

    @property
    def joints(self) -> int:
        """The number of joints J."""

    @property
    def has_feet(self) -> bool:
        """Whether feet are of finite size: `foot` [m] is then a parameter of the robot."""

    @property
    def robot_parameter_shapes(self) -> Shapes:
        """Names and shapes of the parameters of the robot."""

    @property
    def parameter_shapes(self) -> Shapes:
        """Names and shapes of further parameters for toes at one point each."""

    @property
    def variable_shapes(self) -> Shapes:
        """Names and shapes of the variables that a program has for toes at one point each."""

    def compute_robot_parameters(self, robot: Robot) -> dict[str, Array]:
        """Return the parameters of the robot."""

    def at_toes(self, robot: Robot, toes: Array) -> dict[str, Array]:
        """Return parameters and start values of variables for toes (..., N, 3).

        Each is (..., N, rows).
        """

    def points(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[Any]:
        """Return J joints and the toe, (3, N) each, body frame, for angles (J, N)."""

    def pieces(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Return ends (3, N) of the axis of each capsule, body frame, for angles (J, N)."""

    def standing(
        self, robot_parameters: Mapping[str, Any], toes: Any, values: Mapping[str, Any]
    ) -> StandingLimbs:
        """Return limbs with toes (3, N), body frame; values: of parameters and variables there."""
