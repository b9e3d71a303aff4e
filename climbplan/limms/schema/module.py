"""Module spec (`kind: module`): a reconfigurable limb with a latch at both ends (chapter 6.2).

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, quantity, refuse

LINKS = 7
JOINTS = 6
ENDS = 2
OF_MASSES = ("joint_mass", "latch_mass", "ground_moment")  # count with masses only


class ModuleSpec(SpecModel):
    """A limb of six joints: roll, pitch, pitch, roll, pitch, roll from its first end."""

    kind: Literal["module"] = Field(default="module", description="always `module`")
    name: str = Field(min_length=1, description="name used in reports")
    link_lengths: tuple[Number, Number, Number, Number, Number, Number, Number] = quantity(
        "m", "from the first end to the last, joints between them"
    )
    joint_range: tuple[Number, Number, Number, Number, Number, Number] = quantity(
        "rad", "largest angle of each joint either way from straight"
    )
    max_joint_speed: Number = quantity("rad/s", "speed limit of every joint", gt=0)
    max_torque: Number = quantity("N m", "torque limit of every joint", gt=0)
    mass: Number = quantity("kg", "mass of the module", gt=0)
    joint_mass: Number = quantity(
        "kg", "of `mass`, a ball of the links' radius in each of the six joints", default=0.0, ge=0
    )
    latch_mass: Number = quantity(
        "kg",
        "of `mass`, in each of the two ends; what is left over is spread evenly over the links",
        default=0.0,
        ge=0,
    )
    radius: Number = quantity("m", "radius of the links", gt=0)
    max_force: Number = quantity("N", "largest force at a contact or latch (f_max)", gt=0)
    latch_moment: Number = quantity(
        "N m", "moment that a latch holds: on a box, and with masses everywhere", gt=0
    )
    ground_moment: Number = quantity(
        "N m",
        "moment that the ground holds at an end that stands on it, beyond what a disc of the "
        "links' radius gives; counts with masses only",
        default=0.0,
        ge=0,
    )
    latch_dwell: Number = quantity("s", "shortest time that a latch stays closed", ge=0)
    ground_speed: Number = quantity("m/s", "speed limit of a module that drives", gt=0)

    @model_validator(mode="after")
    def _positive(self) -> Self:
        refuse(
            [
                Fault(name, f"expected numbers > 0, got {list(values)}")
                for name, values in (
                    ("link_lengths", self.link_lengths),
                    ("joint_range", self.joint_range),
                )
                if min(values) <= 0
            ]
        )
        mass_of_parts = JOINTS * self.joint_mass + ENDS * self.latch_mass
        if mass_of_parts >= self.mass:
            fault = (
                f"joints and latches weigh {mass_of_parts:g} kg, the whole module {self.mass:g} kg"
            )
            refuse([Fault("joint_mass", fault)])
        return self
