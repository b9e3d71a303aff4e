"""A robot from a URDF, and what a URDF cannot say (`robot: {urdf: PATH, legs: {...}}`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from climbplan.schema.base import (
    NAME_WORDS,
    Fault,
    Number,
    SpecModel,
    Vector,
    is_name,
    quantity,
    refuse,
)
from climbplan.schema.fields import FILE_TAG, MAPPING_TAG
from climbplan.schema.robots.foot import FootSpec
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
    Given,
    Range,
    check_ranges,
)
from climbplan.schema.robots.uncertainty import RobotUncertaintySpec

FEWEST_LEGS = 3
FEWEST_FLAT_FEET = 2  # one of which holds a robot while the other steps


class UrdfJointSpec(SpecModel):
    """What a URDF says wrongly or not at all of one joint."""

    max_torque: Number | None = quantity(
        "N m or N",
        "torque limit, of a joint that slides a force; left out: `effort` of the URDF",
        default=None,
        gt=0,
    )
    max_speed: Number | None = quantity(
        "rad/s or m/s",
        "speed limit; left out: `velocity` of the URDF",
        default=None,
        gt=0,
    )
    stiffness: Number | None = quantity(
        "N m/rad or N/m",
        "stiffness under position control; left out: the robot's",
        default=None,
        gt=0,
    )
    rotor_inertia: Number | None = quantity(
        "kg m^2 or kg",
        "inertia of its rotor behind the gear, as the joint feels it, in simulation; left out: "
        "the robot's",
        default=None,
        gt=0,
    )
    damping: Number | None = quantity(
        "N m s/rad or N s/m",
        "derivative gain under position control, in simulation; left out: the robot's",
        default=None,
        ge=0,
    )


class UrdfLegSpec(SpecModel):
    """One leg: the chain of joints from the base to a toe."""

    toe: str = Field(min_length=1, description="link that touches the terrain")
    toe_offset: Vector = quantity(
        "m", "the point that touches, in the frame of that link", default=(0.0, 0.0, 0.0)
    )
    side: Literal["left", "right", "any", "by place"] = Field(
        default="by place",
        description="wall this limb uses when `terrain.walls` is given; `by place`: that on the "
        "side of its nominal toe",
    )
    posture_deg: dict[str, Number] = quantity(
        "deg",
        "angles of joints, by their names, to which a leg with freedom to choose stays nearest, "
        "and from which others start; joints left out are at zero, or in the middle of their "
        "range if that leaves zero out",
        default={},
    )
    posture_m: dict[str, Number] = quantity(
        "m", "the same of joints that slide, by their names", default={}
    )
    stance: Vector | None = quantity(
        "m",
        "nominal toe position, body frame (x right, y forward, z up, origin in the centre of "
        "mass); left out: where the posture has it",
        default=None,
    )


class UrdfWorkspaceSpec(SpecModel):
    """Balls that stand for a leg's workspace in the posture planner."""

    reach: Number | None = quantity(
        "m",
        "largest distance from first joint to toe; left out: 0.97 of the farthest toe among "
        "sampled postures",
        default=None,
        gt=0,
    )
    stance_radius: Number | None = quantity(
        "m",
        "largest distance of a toe from its nominal stance; left out: of the largest ball all of "
        "whose sampled points can be reached within the joint bounds",
        default=None,
        gt=0,
    )


Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class UrdfRobotSpec(SpecModel):
    """A robot that a URDF describes, with what no URDF says of it."""

    kind: Literal["robot"] = Field(default="robot", description="always `robot`")
    urdf: str = Field(min_length=1, description="path of the URDF (XML, not xacro) or MJCF file")
    name: str | None = Field(
        default=None, min_length=1, description="name used in reports; left out: the URDF's"
    )
    packages: dict[str, str] = Field(
        default={},
        description="package name -> directory, for meshes at `package://name/...`; others are "
        "looked for above the URDF and in ROS_PACKAGE_PATH",
    )
    missing_meshes: Literal["refuse", "ignore"] = Field(
        default="refuse",
        description="what collision meshes without a file do: `ignore` leaves out their shapes "
        "alone, so that those links are as thin as their other shapes or as links without any",
    )
    base: str | None = Field(
        default=None, min_length=1, description="link that is the body; left out: the root link"
    )
    forward: Axis = Field(default="x", description="axis of the base link that points forward")
    up: Axis = Field(
        default="z",
        description="axis of the base link that points up in the robot's posture, square to "
        "`forward`: a humanoid that goes on hands and feet has `forward: z` and `up: -x`",
    )
    mass: Number | None = quantity(
        "kg", "total mass; left out: the sum over the links", default=None, gt=0
    )
    gravity: Number = quantity("m/s^2", "gravitational acceleration along -z", default=9.81, ge=0)
    joint_stiffness: Number = quantity(
        "N m/rad",
        "stiffness of joints under position control (their P gain); assumed if left out",
        default=50.0,
        gt=0,
    )
    slide_stiffness: Number = quantity(
        "N/m",
        "stiffness of joints that slide under position control (their P gain); assumed if left out",
        default=5000.0,
        gt=0,
    )
    joint_rotor_inertia: Number | None = quantity(
        "kg m^2",
        "inertia of rotors behind their gears, as joints that turn feel it, in simulation; left "
        "out: `armature` of an MJCF file, else 0.006 s * torque limit / speed limit",
        default=None,
        gt=0,
    )
    joint_damping: Number | None = quantity(
        "N m s/rad",
        "derivative gain of joints that turn under position control, in simulation; left out: "
        "what damps the rotor critically on the joint's stiffness",
        default=None,
        ge=0,
    )
    structural_compliance_share: Number = quantity(
        "", "share of the limb compliance that comes from the structure", default=0.0, ge=0, lt=1
    )
    joints: dict[str, UrdfJointSpec] = Field(
        default={}, description="joint name -> what the URDF does not say of it"
    )
    locked: dict[str, Number] = quantity(
        "deg",
        "joint name -> angle at which it is held, fixed like a weld: a waist that legs would "
        "share, joints of a leg beyond seven, arms where they are to be out of the way",
        default={},
    )
    locked_m: dict[str, Number] = quantity(
        "m", "joint name -> where it is held, of joints that slide", default={}
    )
    body_half_size: Vector | None = quantity(
        "m",
        "half extents of the body's box hull about the centre of mass; left out: round the base "
        "link's collision geometry, or round the first joints",
        default=None,
    )
    limb_radius: Number | None = quantity(
        "m",
        "radius of links that are straight from joint to joint and toe; left out: each piece of "
        "a leg's collision geometry has a capsule of its own, or 0.02 without any",
        default=None,
        ge=0,
    )
    limb_radii: dict[str, Number] = quantity(
        "m",
        "joint name -> radius of the link that it moves, straight to the next joint or the toe, "
        "in place of `limb_radius` and of collision geometry",
        default={},
    )
    gripper: GripperSpec | None = Field(
        default=None,
        description="grippers on wrists at the toes of all legs, of three joints each: a toe is "
        "then the wrist's centre, and what the URDF has beyond it is held; none if left out",
    )
    foot: FootSpec | None = Field(
        default=None, description="feet of finite size at the toes of all legs; none: points"
    )
    workspace: UrdfWorkspaceSpec = UrdfWorkspaceSpec()
    """Limb workspace of the posture planner."""
    uncertainty: RobotUncertaintySpec = RobotUncertaintySpec()
    """What is uncertain of the robot, for simulated worlds; specs may say otherwise."""
    legs: dict[str, UrdfLegSpec] = Field(
        description="leg name -> its toe; at least three, or two with flat feet, in leg order"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = []
        if len(self.legs) < (FEWEST_FLAT_FEET if self.flat_feet else FEWEST_LEGS):
            min_legs = "two legs" if self.flat_feet else "three legs"
            faults.append(Fault("legs", f"expected at least {min_legs}, got {len(self.legs)}"))
        faults += [
            Fault("legs", f"expected {NAME_WORDS}, got {n[:40]!r}")
            for n in self.legs
            if not is_name(n)
        ]
        if self.up[-1] == self.forward[-1]:
            wrong_key, other_key = (
                ("up", "forward") if "up" in self.model_fields_set else ("forward", "up")
            )
            axes = {"up": self.up, "forward": self.forward}
            other_axis = f"`{other_key}: {axes[other_key]}`"
            message = f"expected an axis square to {other_axis}, got {axes[wrong_key]!r}"
            faults.append(Fault(wrong_key, message))
        if self.body_half_size is not None and min(self.body_half_size) <= 0:
            size = list(self.body_half_size)
            faults.append(Fault("body_half_size", f"expected three numbers > 0, got {size}"))
        if self.foot is not None and self.gripper is not None:
            faults.append(Fault("foot", "expected grippers or feet at the toes, got both"))
        if not faults:
            faults = self._sizes()
        refuse(faults)
        return self

    @property
    def flat_feet(self) -> bool:
        """Return whether its feet have soles."""
        return self.foot is not None and self.foot.flat

    @property
    def foot_radius(self) -> float:
        """Radius of spherical feet [m]; zero of others."""
        return 0.0 if self.foot is None else self.foot.radius or 0.0

    @property
    def locked_positions(self) -> dict[str, float]:
        """Joint name -> angle [rad] or place [m] at which it is held."""
        angles = {name: float(np.deg2rad(degrees)) for name, degrees in self.locked.items()}
        return angles | {name: float(place) for name, place in self.locked_m.items()}

    def _sizes(self) -> list[Fault]:
        """Return faults of quantities outside the range that a robot's numbers can have."""
        quantities: dict[str, tuple[Given, Range]] = {
            "mass": (self.mass, MASS),
            "gravity": (self.gravity, GRAVITY),
            "joint_stiffness": (self.joint_stiffness, STIFFNESS),
            "slide_stiffness": (self.slide_stiffness, STIFFNESS),
            "joint_rotor_inertia": (self.joint_rotor_inertia, ROTOR_INERTIA),
            "joint_damping": (self.joint_damping, DAMPING),
            "body_half_size": (self.body_half_size, LENGTH),
            "limb_radius": (self.limb_radius, THICKNESS),
            **{f"limb_radii.{name}": (r, THICKNESS) for name, r in self.limb_radii.items()},
            **{
                f"foot.{key}": (None if self.foot is None else vars(self.foot)[key], LENGTH)
                for key in ("radius", "length", "width")
            },
            "workspace.reach": (self.workspace.reach, LENGTH),
            "workspace.stance_radius": (self.workspace.stance_radius, LENGTH),
        }
        for name, joint in self.joints.items():
            quantities[f"joints.{name}.max_torque"] = (joint.max_torque, TORQUE)
            quantities[f"joints.{name}.max_speed"] = (joint.max_speed, SPEED)
            quantities[f"joints.{name}.stiffness"] = (joint.stiffness, STIFFNESS)
            quantities[f"joints.{name}.rotor_inertia"] = (joint.rotor_inertia, ROTOR_INERTIA)
            quantities[f"joints.{name}.damping"] = (joint.damping, DAMPING)
        for name, leg in self.legs.items():
            quantities[f"legs.{name}.toe_offset"] = (leg.toe_offset, PLACE)
            quantities[f"legs.{name}.stance"] = (leg.stance, PLACE)
        return check_ranges(quantities)


def _discriminate(value: Any) -> str:
    return MAPPING_TAG if isinstance(value, dict | UrdfRobotSpec) else FILE_TAG


RobotReference = Annotated[
    Annotated[str, Field(min_length=1), Tag(FILE_TAG)] | Annotated[UrdfRobotSpec, Tag(MAPPING_TAG)],
    Discriminator(_discriminate),
]
