"""Module spec (`kind: module`): a reconfigurable limb with a latch at both ends (chapter 6.2)."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.spec.base import Fault, Number, SpecModel, quantity, refuse

LINKS = 7
JOINTS = 6


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
    max_torque: Number = quantity("N m", "torque limit of every joint, told in reports", gt=0)
    mass: Number = quantity("kg", "mass of the module, told in reports", gt=0)
    radius: Number = quantity("m", "radius of the links", gt=0)
    max_force: Number = quantity("N", "largest force at a contact or latch (f_max)", gt=0)
    latch_moment: Number = quantity("N m", "moment that a latch on a box holds", gt=0)
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
        return self
