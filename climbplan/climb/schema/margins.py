"""Margins that a plan keeps so that it stands in a world that is not quite the planned one."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from climbplan.arrays import Array, IntArray
from climbplan.schema.base import Number, SpecModel, quantity


class MarginsSpec(SpecModel):
    """What every toe in contact keeps in hand, as far as terrain and motors allow it.

    Bounds of `force` are never missed. Margins are asked for beyond them: at each instant the plan
    keeps the largest common share of all of them, and says where that is less than the whole.
    """

    @property
    def asked(self) -> bool:
        """Return whether there are margins of toes; `margins: none` has none, and soles do not
        count.
        """
        values = (
            self.normal_force,
            self.friction,
            self.slip,
            self.depth,
            self.torque,
            self.stiffness,
        )
        return any(value > 0 for value in (*values, self.edge))

    @property
    def asked_of_grips(self) -> bool:
        """Return whether there are margins of grips."""
        return self.pull > 0 or self.slip > 0

    def factors(self, rounds: IntArray) -> Array:
        """Return factors on pressure, friction and pull for instants in rounds (K,), counted from
        1.
        """
        return np.array([self.rounds.get(int(number), 1.0) for number in rounds])

    normal_force: Number = quantity(
        "weight",
        "pressure of every toe in contact, in weights of the robot: a toe that presses with next "
        "to nothing slides at the first disturbance",
        default=0.1,
        ge=0,
        lt=1,
    )
    friction: Number = quantity(
        "weight",
        "pressure that a toe may miss, in weights of the robot, before its shear leaves the "
        "friction cone over S_mu: motors and limbs a tenth stiffer or softer than believed move as "
        "much from toe to toe",
        default=0.08,
        ge=0,
        lt=1,
    )
    slip: Number = quantity(
        "",
        "share of its friction that a surface may lack before a toe slides on it, where that asks "
        "for more than S_mu",
        default=0.2,
        ge=0,
        lt=1,
    )
    pull: Number = quantity(
        "weight",
        "further pull off its surface that every grip holds, in weights of the robot, friction and "
        "spines counted without S_mu; of robots with grippers, which keep this and `slip`",
        default=0.1,
        ge=0,
        lt=1,
    )
    depth: Number = quantity(
        "m",
        "how far inside its surface every toe in contact is commanded: friction alone holds a toe "
        "that is commanded off its surface, which slides or never touches",
        default=0.005,
        ge=0,
        le=0.1,
    )
    torque: Number = quantity(
        "",
        "part of its torque limit that every motor of a limb in contact has left: a motor at its "
        "limit gives way like no spring, and brings nothing of what the regulator asks for",
        default=0.1,
        ge=0,
        lt=1,
    )
    stiffness: Number = quantity(
        "", "share of the body's stiffness that bracing leaves", default=0.3, ge=0, lt=1
    )
    edge: Number = quantity(
        "m",
        "distance that planned toes keep from edges of their regions beyond which nothing as good "
        "goes on: a toe that lands a little aside finds its surface all the same",
        default=0.01,
        ge=0,
        le=0.1,
    )
    sole: Number = quantity(
        "",
        "part of a flat foot's half length and width by which its centre of pressure stays inside "
        "the edges of its sole: a foot that is pressed at an edge tips over it at the first "
        "disturbance; of robots with flat feet",
        default=0.6,
        ge=0,
        lt=1,
    )
    rounds: dict[Annotated[int, Field(ge=1)], Annotated[Number, Field(ge=0)]] = Field(
        default={},
        description="factors on pressure, friction and pull in single rounds, by number; what "
        "`risk` asks for where a plan fell",
    )


NO_MARGINS = MarginsSpec(
    normal_force=0.0,
    friction=0.0,
    slip=0.0,
    pull=0.0,
    depth=0.0,
    torque=0.0,
    stiffness=0.0,
    edge=0.0,
    sole=0.0,
)


def _parse_none(value: Any) -> Any:
    return NO_MARGINS if value == "none" else value


Margins = Annotated[
    MarginsSpec,
    BeforeValidator(_parse_none, json_schema_input_type=MarginsSpec | Literal["none"]),
]
