"""Specs of uncertain quantities in climbs and transitions: distributions of robot and terrain.

Robot files say what is uncertain of the robot, specs of robot and terrain; what neither says has
the defaults here.
"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Discriminator, Field, Tag, model_validator

from climbplan.schema.base import Fault, Interval, Number, SpecModel, refuse
from climbplan.schema.fields import MAPPING_TAG, NUMBER_TAG


class SpreadSpec(SpecModel):
    """A distribution: `normal` or `uniform`."""

    normal: Number | None = Field(
        default=None, ge=0, description="standard deviation of a normal distribution about nominal"
    )
    uniform: Interval | None = Field(
        default=None, description="ends of an interval in which every value is as likely"
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.normal is None) == (self.uniform is None):
            refuse(
                [Fault("", "expected one of `normal` (a standard deviation) and `uniform` (ends)")]
            )
        if self.uniform is not None and self.uniform[0] > self.uniform[1]:
            low, high = self.uniform
            refuse([Fault("uniform", f"expected the lower end first, got [{low:g}, {high:g}]")])
        return self


def _discriminate(value: Any) -> str:
    return MAPPING_TAG if isinstance(value, dict | SpreadSpec) else NUMBER_TAG


Spread = Annotated[
    Annotated[Number, Field(ge=0), Tag(NUMBER_TAG)] | Annotated[SpreadSpec, Tag(MAPPING_TAG)],
    Discriminator(_discriminate),
]
_FORM = "a standard deviation, `{normal: S}` or `{uniform: [A, B]}`"


def _spread_field(unit: str, description: str, default: float) -> Any:
    return Field(
        default,
        description=f"{description}; {_FORM}{f' [{unit}]' if unit else ''}",
        json_schema_extra={"unit": unit},
    )


class RobotUncertaintySpec(SpecModel):
    """What is uncertain of a robot."""

    mass: Spread = _spread_field("", "departure of the mass, as a share of it", 0.05)
    com_mm: Spread = _spread_field(
        "mm", "departure of the centre of mass along each body axis", 0.0
    )
    joint_stiffness: Spread = _spread_field(
        "", "departure of each joint's stiffness, as a share of it, joints by themselves", 0.1
    )
    motor_gain: Spread = _spread_field(
        "", "departure of all motors' gain together, as a share of it", 0.0
    )
    backlash_deg: Spread = Field(
        default=0.2,
        description="backlash of each joint; a number is the largest, each backlash from 0 as "
        "likely; or a distribution, below zero counting as none [deg]",
        json_schema_extra={"unit": "deg"},
    )
    toe_placement_mm: Spread = _spread_field(
        "mm", "by how much each foothold is missed along each axis of the world", 0.0
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        refuse(self._shares("mass", "joint_stiffness", "motor_gain"))
        return self

    def _shares(self, *names: str) -> list[Fault]:
        """Return departures that would leave nothing, or less."""
        faults = []
        for name in names:
            value = getattr(self, name)
            if isinstance(value, SpreadSpec):
                if value.uniform is not None and value.uniform[0] <= -1:
                    ends = list(value.uniform)
                    faults.append(Fault(f"{name}.uniform", f"expected shares above -1, got {ends}"))
                value = value.normal or 0.0
                name = f"{name}.normal"
            if value >= 1:
                faults.append(Fault(name, f"expected a share below 1, got {value:g}"))
        return faults


def states_uncertainty(spec: RobotUncertaintySpec, robot: RobotUncertaintySpec) -> bool:
    """Return whether a spec or robot file states any distribution, as against defaults alone.

    Args:
        spec: Section `uncertainty` of the spec.
        robot: Section `uncertainty` of the robot file.
    """
    return bool(spec.model_fields_set or robot.model_fields_set)


class UncertaintySpec(RobotUncertaintySpec):
    """What is uncertain of robot and terrain, for simulated worlds (`climbplan simulate`).

    Of the robot, what is left out is as the robot's file says.
    """

    friction: Spread = _spread_field(
        "", "departure of each surface's friction coefficient, as a share of it", 0.2
    )
    surface_mm: Spread = _spread_field(
        "mm", "how far each surface lies off its place along its normal, a tube's wall inward", 3.0
    )
    surface_tilt_deg: Spread = _spread_field(
        "deg", "how far each flat surface is turned about either of two axes in its plane", 0.0
    )

    @model_validator(mode="after")
    def _terrain_possible(self) -> Self:
        refuse(self._shares("friction"))
        return self
