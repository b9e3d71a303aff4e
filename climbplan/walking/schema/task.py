"""Walking tasks (8.2): horizon, start, reference, and weights of the objective.

Published methods, and equation numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse

Pair = tuple[Number, Number]


class WalkStartSpec(SpecModel):
    """Where the body starts; the toes stand under it."""

    position: Pair = quantity("m", "x and y of the centre of mass", default=(0.0, 0.0))
    height: Number | None = quantity(
        "m",
        "of the centre of mass above the ground under it, of spherical feet above their centres; "
        "left out: as the robot stands",
        default=None,
        gt=0,
        lt=2,
    )
    velocity: Vector = quantity("m/s", "world frame", default=(0.0, 0.0, 0.0))
    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw", default=(0.0, 0.0, 0.0))
    angular_velocity: Vector = quantity("rad/s", "world frame", default=(0.0, 0.0, 0.0))
    toes: dict[str, Pair] = quantity(
        "m", "x and y of toes, world frame, by leg; the middle of its workspace if left out", {}
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        refuse(_angle_faults("rpy_deg", self.rpy_deg))
        return self


class WalkReferenceSpec(SpecModel):
    """What is tracked."""

    velocity: Vector = quantity("m/s", "world frame", default=(1.8, 0.0, 0.0))
    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw", default=(0.0, 0.0, 0.0))
    height: Number | None = quantity(
        "m",
        "of the centre of mass above the ground, of spherical feet above their centres; left out: "
        "as the robot stands",
        default=None,
        gt=0,
        lt=2,
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        refuse(_angle_faults("rpy_deg", self.rpy_deg))
        return self


class WalkGoalSpec(SpecModel):
    """Where the body has to be at the end of the horizon."""

    position: Pair = quantity("m", "x and y of the centre of mass, world frame")
    within: Number = quantity("m", "off it at most, along x and along y", 0.1, gt=0, le=10)


def _angle_faults(key: str, rpy: Vector) -> list[Fault]:
    return [
        Fault(key, f"expected {name} between -90 and 90 degrees, got {angle:g}")
        for name, angle in zip(("roll", "pitch", "yaw"), rpy, strict=True)
        if not (-90 < angle < 90 or (name == "yaw" and abs(angle) == 90))
    ]


class WalkTaskSpec(SpecModel):
    """Horizon, start and reference."""

    knots: Count = quantity("", "intervals of the horizon", default=9, ge=2, le=40)
    dt: Number = quantity("s", "length of an interval", default=0.08, gt=0.005, le=0.5)
    integrator: Literal["euler", "mean"] = Field(
        default="mean",
        description="`mean`: moment arms averaged over each interval in which the body moves on, "
        "which agrees with continuous time; `euler`: forward Euler between knots, as published, "
        "which does not",
    )
    start: WalkStartSpec = WalkStartSpec()
    """Where the body starts."""
    reference: WalkReferenceSpec = WalkReferenceSpec()
    """What is tracked."""
    goal: WalkGoalSpec | None = Field(
        default=None, description="where the body has to be at the end; anywhere if left out"
    )
    min_contacts: Count = quantity(
        "", "legs that stand in every interval at least", default=0, ge=0, le=4
    )
    workspace_over_stance: bool = Field(
        default=True,
        description="standing toes stay in their boxes until the interval's end, while the body "
        "moves on; `false`: at knots only, as published (`spatial-branch-and-bound` looks for "
        "gaits by the latter)",
    )
    swing_clearance: Number = quantity(
        "m", "height of swinging toes above the ground", default=0.04, gt=0, le=0.12
    )


class WalkWeightsSpec(SpecModel):
    """Weights of the objective, eq. (8.30); the published ones if left out."""

    velocity: Vector = quantity("s^2/m^2", "w_v on x, y, z", default=(100.0, 100.0, 10.0))
    angles: Vector = quantity("1/rad^2", "w_theta on roll, pitch, yaw", default=(10.0, 10.0, 10.0))
    height: Number = quantity("1/m^2", "w_h", default=10.0, ge=0)
    motion: Number = quantity("1/m^2", "on the body's steps", default=1.0, ge=0)
    force_difference: Number | None = quantity(
        "1/N^2",
        "on differences between the legs' forces; published without a unit of force, 1 for forces "
        "in units of half the weight; left out: 1e-3 for SCALER's weight of 61.8 N, for others by "
        "the square of the weight less or more",
        None,
        ge=0,
    )

    @model_validator(mode="after")
    def _not_negative(self) -> Self:
        refuse(
            [
                Fault(key, f"expected three numbers >= 0, got {list(values)}")
                for key, values in (("velocity", self.velocity), ("angles", self.angles))
                if min(values) < 0
            ]
        )
        return self
