"""What programs state of limbs, whatever these are made of: one interface of all mechanisms.

A program has the toes of N limbs as expressions in the body frame and asks for joint angles there,
for torques of forces, and for where toes would be with joints elsewhere. A mechanism with inverse
kinematics in closed form answers with functions of the toes (`stated_closed_form.py`); others have
angles as variables of the program and rows that tie them to the toes (`stated_chains.py`). Matrices
have one column a limb. What a program is built for is hashable; everything else is a number.
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
    """Rows that hold where a limb stands at its toe; bounds left out are given with the numbers."""

    name: str
    rows: Any  # (r, N)
    unit: str
    lower: float | None = None
    upper: float | None = None


class StandingLimbs(Protocol):
    """N limbs with their toes at given points."""

    @property
    def angles(self) -> Any:
        """(J, N) [rad]."""

    def ties(self, room: float) -> list[Tie]:
        """What has to hold for the toes to be in reach; room: off full stretch, of a cosine."""

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Joint torques (J, N) of forces (3, N) on the toes and moments about them, body frame."""

    def centre(self) -> Any:
        """(3, 1) centre of mass of the robot, body frame [m]; None where limbs weigh nothing."""

    def weight_torques(self, down: Any) -> Any:
        """Joint torques (J, N) of links that pull along `down` (3, 1), over the robot's weight [m].

        Body frame; None where limbs weigh nothing.
        """

    def free_toes(self, bent: Any) -> Any:
        """Where toes (3, N) would be in free space, body frame, with joints `bent` (J, N) back."""


class StatedLimbs(Protocol):
    """N limbs with J joints each, as programs are built for."""

    @property
    def limbs(self) -> int:
        """N."""

    @property
    def joints(self) -> int:
        """J."""

    @property
    def footed(self) -> bool:
        """Whether feet are of finite size: `foot` [m] is then one of the robot's numbers."""

    @property
    def numbers(self) -> Shapes:
        """Names and shapes of the robot's numbers."""

    @property
    def given(self) -> Shapes:
        """Names and shapes of further numbers for toes at one point each."""

    @property
    def found(self) -> Shapes:
        """Names and shapes of the variables that a program has for toes at one point each."""

    def values(self, robot: Robot) -> dict[str, Array]:
        """The robot's numbers."""

    def at_toes(self, robot: Robot, toes: Array) -> dict[str, Array]:
        """What is given, and where what is found starts, for toes (..., N, 3): (..., N, rows)."""

    def points(self, numbers: Mapping[str, Any], angles: Any) -> list[Any]:
        """J joints and the toe, (3, N) each, body frame, for angles (J, N)."""

    def pieces(self, numbers: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Ends (3, N) of the axis of each capsule of the limbs, body frame, for angles (J, N)."""

    def standing(
        self, numbers: Mapping[str, Any], toes: Any, own: Mapping[str, Any]
    ) -> StandingLimbs:
        """Limbs with toes (3, N), body frame; own: what is given and found there."""
