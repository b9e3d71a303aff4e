"""Robot spec: any number of limbs N >= 3 with coxa, femur and tibia (`robots/silvia.yaml`)."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, Vector, name_field, quantity, refuse
from climbplan.schema.robots.gripper import GripperSpec
from climbplan.schema.robots.ranges import (
    DAMPING,
    GRAVITY,
    LENGTH,
    MASS,
    PLACE,
    ROTOR_INERTIA,
    SPEED,
    STIFFNESS,
    THICKNESS,
    TORQUE,
    check_ranges,
)
from climbplan.schema.robots.uncertainty import RobotUncertaintySpec


class FiveBarSpec(SpecModel):
    """Two cranks in the leg's vertical plane, the last link on one of them, a coupler to the other.

    Joints are yaw, crank F and crank A; crank angles count from straight down towards outward. A
    limb's `link_lengths` are not used by such legs but to draw them.
    """

    offset: Number = quantity("m", "of both cranks' axes, outward from the yaw axis", default=0.0)
    axis_f: Number = quantity("m", "height of crank F's axis above the shoulder")
    axis_a: Number = quantity("m", "height of crank A's axis above the shoulder")
    crank_f: Number = quantity("m", "length of crank F, which carries the last link", gt=0)
    crank_a: Number = quantity("m", "length of crank A", gt=0)
    coupler: Number = quantity("m", "length of the coupler between crank A and the link", gt=0)
    link: Number = quantity("m", "from crank F's end to the toe", gt=0)
    held_along: Number = quantity("m", "where the coupler holds the link: along it", gt=0)
    held_across: Number = quantity("m", "and beside it, towards growing tilt", default=0.0)

    @model_validator(mode="after")
    def _closes(self) -> Self:
        held_length = (self.held_along**2 + self.held_across**2) ** 0.5
        longest = self.crank_f + self.crank_a + held_length + abs(self.axis_f - self.axis_a)
        if self.coupler >= longest:
            refuse([Fault("coupler", f"expected less than {longest:.3g}, or nothing ever closes")])
        return self


class LimbSpec(SpecModel):
    """One limb: coxa yaw about the body's z, then femur and tibia in the limb's plane."""

    name: str = name_field("short name used in reports, such as LF")
    shoulder: Vector = quantity("m", "first joint in the body frame (x right, y forward, z up)")
    mount_yaw_deg: Number = quantity("deg", "direction of the coxa at zero angle, about body z")
    link_lengths: Vector = quantity("m", "coxa, femur and tibia lengths")
    max_torque: Vector = quantity("N m", "torque limit of coxa, femur and tibia joints")
    joint_stiffness: Vector = quantity("N m/rad", "torsional stiffness of the P-controlled joints")
    joint_lower_deg: Vector = quantity("deg", "lower joint bounds (coxa, femur, tibia)")
    joint_upper_deg: Vector = quantity("deg", "upper joint bounds (coxa, femur, tibia)")
    max_joint_speed: Vector = quantity("rad/s", "joint speed limits", default=(4.7, 4.7, 4.7))
    stance: Vector = quantity("m", "nominal toe position while climbing, body frame")
    side: Literal["left", "right", "any"] = Field(
        default="any", description="wall this limb uses when `terrain.walls` is given"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = [
            Fault(label, f"expected three numbers > 0, got {list(values)}")
            for label, values in (
                ("link_lengths", self.link_lengths),
                ("max_torque", self.max_torque),
                ("joint_stiffness", self.joint_stiffness),
                ("max_joint_speed", self.max_joint_speed),
            )
            if min(values) <= 0
        ]
        faults += [
            Fault(
                "joint_lower_deg",
                f"{joint}: expected less than joint_upper_deg {high:g}, got {low:g}",
            )
            for joint, low, high in zip(
                ("coxa", "femur", "tibia"), self.joint_lower_deg, self.joint_upper_deg, strict=True
            )
            if low >= high
        ]
        if not faults:
            faults = check_ranges(
                {
                    "shoulder": (self.shoulder, PLACE),
                    "link_lengths": (self.link_lengths, LENGTH),
                    "max_torque": (self.max_torque, TORQUE),
                    "joint_stiffness": (self.joint_stiffness, STIFFNESS),
                    "max_joint_speed": (self.max_joint_speed, SPEED),
                    "stance": (self.stance, PLACE),
                }
            )
        refuse(faults)
        return self


class WorkspaceSpec(SpecModel):
    """Balls that stand for a limb's workspace in the posture planner (constraint C of Fig. 5.1)."""

    reach: Number = quantity("m", "largest distance from shoulder to toe (Delta_FK)", gt=0)
    stance_radius: Number = quantity(
        "m", "largest distance of a toe from the limb's nominal stance, body frame", gt=0
    )


class RobotSpec(SpecModel):
    """A robot whose limbs push against the terrain with point contacts."""

    kind: Literal["robot"] = Field(default="robot", description="always `robot`")
    name: str = Field(min_length=1, description="name used in reports")
    mass: Number = quantity("kg", "total mass, acting at the body frame's origin", gt=0)
    gravity: Number = quantity("m/s^2", "gravitational acceleration along -z", default=9.81, ge=0)
    structural_compliance_share: Number = quantity(
        "", "share of the limb compliance that comes from the structure", default=0.0, ge=0, lt=1
    )
    joint_rotor_inertia: Number | None = quantity(
        "kg m^2",
        "inertia of rotors behind their gears, as joints feel it, in simulation; left out: by "
        "torque and speed limits, 0.006 s * max_torque / max_joint_speed",
        default=None,
        gt=0,
    )
    joint_damping: Number | None = quantity(
        "N m s/rad",
        "derivative gain of joints under position control, in simulation; left out: what damps "
        "the rotor critically on the joint's stiffness",
        default=None,
        ge=0,
    )
    body_half_size: Vector = quantity("m", "half extents of the body's box hull (x, y, z)")
    limb_radius: Number = quantity(
        "m", "radius of the capsules round the links", default=0.02, ge=0
    )
    workspace: WorkspaceSpec = Field(description="limb workspace of the posture planner")
    limbs: tuple[LimbSpec, ...] = Field(min_length=3, description="limbs, in leg order")
    five_bar: FiveBarSpec | None = Field(
        default=None,
        description="legs of a yaw joint and a five-bar linkage instead of coxa, femur and tibia; "
        "numbers by joint are then of yaw, crank F and crank A",
    )
    gripper: GripperSpec | None = Field(
        default=None, description="grippers on wrists at the ends of all limbs; none if left out"
    )

    uncertainty: RobotUncertaintySpec = RobotUncertaintySpec()
    """What is uncertain of the robot, for simulated worlds; specs may say otherwise."""

    @property
    def limb_names(self) -> tuple[str, ...]:
        """Limbs, in leg order."""
        return tuple(limb.name for limb in self.limbs)

    @model_validator(mode="after")
    def _limb_names_differ(self) -> Self:
        names = [limb.name for limb in self.limbs]
        faults = [
            Fault(
                f"limbs.{i}.name", f"names must differ, {name!r} is also limb {names.index(name)}"
            )
            for i, name in enumerate(names)
            if names.index(name) < i
        ]
        if min(self.body_half_size) <= 0:
            size = list(self.body_half_size)
            faults.append(Fault("body_half_size", f"expected three numbers > 0, got {size}"))
        if not faults:
            faults = check_ranges(
                {
                    "mass": (self.mass, MASS),
                    "gravity": (self.gravity, GRAVITY),
                    "body_half_size": (self.body_half_size, LENGTH),
                    "limb_radius": (self.limb_radius, THICKNESS),
                    "joint_rotor_inertia": (self.joint_rotor_inertia, ROTOR_INERTIA),
                    "joint_damping": (self.joint_damping, DAMPING),
                    "workspace.reach": (self.workspace.reach, LENGTH),
                    "workspace.stance_radius": (self.workspace.stance_radius, LENGTH),
                }
            )
        refuse(faults)
        return self
