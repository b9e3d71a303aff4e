"""A robot as arrays that kinematics and mechanics compute with."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.chain_pose import RADIAN
from climbplan.robots.coxa_femur_tibia import CoxaFemurTibia
from climbplan.robots.five_bar import FiveBar, Linkage
from climbplan.robots.foot import Foot, Sole
from climbplan.robots.gripper import Gripper
from climbplan.robots.joint_dynamics import JointDynamics, default_damping, default_rotor_inertia
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.mechanism import Mechanism
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.robot import RobotSpec


@dataclass(frozen=True)
class MountedCapsules:
    """C capsules of each of N limbs at zero angles; limbs with fewer repeat some."""

    joint: IntArray  # (N, C) number of the joint that moves it
    ends: Array  # (N, C, 2, 3) of its axis, the second nearer the toe, body frame [m]
    radius: Array  # (N, C) [m]

    def only(self, limbs: slice) -> Self:
        """Return the capsules of some limbs."""
        return type(self)(self.joint[limbs], self.ends[limbs], self.radius[limbs])


_BY_LIMB = (
    "limb_names",
    "sides",
    "shoulder_body",
    "mount_yaw",
    "link_lengths",
    "max_torque",
    "joint_stiffness",
    "joint_lower",
    "joint_upper",
    "max_joint_speed",
    "stance_body",
)


@dataclass(frozen=True)
class Robot:
    """N limbs with up to J joints on a rigid body; body frame x right, y forward, z up.

    Limbs are coxa, femur and tibia (J = 3) unless `mechanism` says what else they are.
    """

    name: str
    mass: float  # [kg], acts at the body origin unless `links` say where
    gravity: float  # [m/s^2]
    structural_compliance_share: float  # part of the limb compliance beside the joints'
    limb_names: tuple[str, ...]
    sides: tuple[str, ...]  # "left", "right" or "any"
    shoulder_body: Array  # (N, 3) first joint [m]
    mount_yaw: Array  # (N,) direction of the coxa at zero angle [rad]
    link_lengths: Array  # (N, J) coxa, femur, tibia, or the distances between joints and toe [m]
    max_torque: Array  # (N, J) [N m], of joints that slide a force [N]
    joint_stiffness: Array  # (N, J) [N m/rad], [N/m]
    joint_lower: Array  # (N, J) [rad], [m]
    joint_upper: Array  # (N, J) [rad], [m]
    max_joint_speed: Array  # (N, J) [rad/s], [m/s]
    stance_body: Array  # (N, 3) nominal toe positions [m]
    body_hull: Array  # (8, 3) corners of the body's box [m]
    reach: float  # Delta_FK, largest shoulder-toe distance of the posture planner [m]
    stance_radius: float  # largest toe distance from its stance in the posture planner [m]
    limb_radius: float  # capsule radius of the links, the largest where they differ [m]
    mechanism: Mechanism | None = None  # None: coxa, femur and tibia of the lengths above
    gripper: Gripper | None = None  # on a wrist at every toe
    foot: Foot | None = None  # at every toe; None: toes are points
    links: LinkMasses | None = None  # of limbs that are chains; None: limbs weigh nothing
    capsules: MountedCapsules | None = None  # None: from joint to joint, as thick as limb_radius
    body_parts: tuple[Array, ...] = ()  # (V, 3) convex parts that limbs keep off; none: the hull
    # (T, 4) limb and capsule, and limb and capsule or -1 and 0 for the body: parts that always
    # touch, by the capsules that contain them, and that no check tests
    touching: IntArray = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    dynamics: JointDynamics | None = None  # of the joints; None: by their limits (`dynamics_of`)

    @property
    def limb_count(self) -> int:
        """N."""
        return len(self.limb_names)

    @property
    def joint_count(self) -> int:
        """J, joints of the limb that has most."""
        return int(self.max_torque.shape[1])

    @property
    def standoff(self) -> float:
        """The distance of toes from the surfaces that they stand on [m]."""
        if self.gripper is not None:
            return self.gripper.length
        return 0.0 if self.foot is None else self.foot.radius

    @property
    def sole(self) -> Sole | None:
        """The soles of flat feet; None for feet of other kinds."""
        return None if self.foot is None else self.foot.sole

    def pressed_within(self, margin: float) -> Self:
        """Return the robot with soles that are shorter and narrower by the fraction `margin`."""
        if self.foot is None or self.foot.sole is None or margin == 0:
            return self
        return replace(self, foot=replace(self.foot, sole=self.foot.sole.within(margin)))

    @property
    def limbs(self) -> Mechanism:
        """The kinematics of all limbs."""
        if self.mechanism is not None:
            return self.mechanism
        return CoxaFemurTibia(self.shoulder_body, self.mount_yaw, self.link_lengths)

    @property
    def has_joint(self) -> BoolArray:
        """Whether a limb has a joint of that number, (N, J)."""
        return np.array([[bool(name) for name in names] for names in self.limbs.joint_names])

    @property
    def motor_names(self) -> tuple[str, ...]:
        """Names of all joints that have motors, limb by limb, as every export has them.

        Those of the URDF where the robot is from one, else limb and joint: "RF_femur".
        """
        joint_names = self.limbs.joint_names
        if isinstance(self.mechanism, SerialChain):  # joints that mimic others have no motor
            return tuple(name for names in joint_names for name in names if name)
        return tuple(
            f"{limb}_{name}"
            for limb, names in zip(self.limb_names, joint_names, strict=True)
            for name in names
            if name
        )

    @property
    def slides(self) -> BoolArray:
        """Prismatic joints (N, J), whose angles are lengths, torques forces, and so on."""
        if isinstance(self.mechanism, SerialChain):
            return self.mechanism.sliding
        return np.zeros(self.max_torque.shape, bool)

    @property
    def joint_unit(self) -> Array:
        """Length [m] that counts as one radian of prismatic joints (N, J); 1 for revolute ones."""
        return np.where(self.slides, RADIAN, 1.0)

    @property
    def longest_links(self) -> Array:
        """The `link_lengths` (N, J), of prismatic joints at their longest extension [m]."""
        chain = self.mechanism
        if not isinstance(chain, SerialChain) or chain.slide_zero is None:
            return self.link_lengths
        limit = np.where(self.has_joint, np.maximum(-self.joint_lower, self.joint_upper), 0.0)
        extension = (np.abs(chain.drives) @ np.maximum(limit, 0.0)[..., None])[..., 0]
        return np.asarray(self.link_lengths + np.where(self.slides, extension, 0.0))

    def joint_name(self, limb: int, joint: int) -> str:
        """Return the name of a joint, and of the link that it moves: "femur"."""
        names = self.limbs.joint_names[limb]
        if isinstance(self.mechanism, SerialChain):
            names = self.mechanism.names[limb]
        return next((name for name in names[joint:] if name), names[-1])

    def one_limb(self, limb: int) -> Self:
        """Return the robot with one limb alone, for faster kinematics."""
        keep = slice(limb, limb + 1)
        rows: dict[str, Any] = {
            name: value[keep] for name, value in vars(self).items() if name in _BY_LIMB
        }
        if self.mechanism is not None:
            rows["mechanism"] = self.mechanism.only(keep)
        if self.capsules is not None:
            rows["capsules"] = self.capsules.only(keep)
        if self.foot is not None:
            rows["foot"] = self.foot.only(keep)
        return replace(self, **rows, links=None, dynamics=None)

    @property
    def weight(self) -> float:
        """Mass times gravity [N]."""
        return self.mass * self.gravity

    def centre_of_mass(self, angles: Array) -> Array:
        """Return the centre of mass (..., 3) at angles (..., N, J), body frame [m].

        It is the origin if limbs weigh nothing.
        """
        if self.links is None or not isinstance(self.mechanism, SerialChain):
            return np.zeros((*angles.shape[:-2], 3))
        return self.links.centre(self.mechanism, angles)

    @classmethod
    def from_spec(cls, spec: RobotSpec) -> Self:
        """Build the arrays of a validated robot spec."""
        limbs = spec.limbs

        def rows(attribute: str) -> Array:
            return np.array([getattr(limb, attribute) for limb in limbs], dtype=float)

        mechanism = None
        if spec.five_bar is not None:
            yaw = np.deg2rad(rows("mount_yaw_deg"))
            linkage = Linkage(**spec.five_bar.model_dump())
            mechanism = FiveBar(rows("shoulder"), yaw, linkage)
        corners = itertools.product((-1.0, 1.0), repeat=3)
        return cls(
            name=spec.name,
            mass=spec.mass,
            gravity=spec.gravity,
            structural_compliance_share=spec.structural_compliance_share,
            limb_names=tuple(limb.name for limb in limbs),
            sides=tuple(limb.side for limb in limbs),
            shoulder_body=rows("shoulder"),
            mount_yaw=np.deg2rad(rows("mount_yaw_deg")),
            link_lengths=rows("link_lengths"),
            max_torque=rows("max_torque"),
            joint_stiffness=rows("joint_stiffness"),
            joint_lower=np.deg2rad(rows("joint_lower_deg")),
            joint_upper=np.deg2rad(rows("joint_upper_deg")),
            max_joint_speed=rows("max_joint_speed"),
            stance_body=rows("stance"),
            body_hull=np.array(list(corners)) * np.array(spec.body_half_size),
            reach=spec.workspace.reach,
            stance_radius=spec.workspace.stance_radius,
            limb_radius=spec.limb_radius,
            mechanism=mechanism,
            gripper=None if spec.gripper is None else Gripper.from_spec(spec.gripper),
            dynamics=_build_dynamics(spec),
        )


def _build_dynamics(spec: RobotSpec) -> JointDynamics:
    """Return the stated joint dynamics of each limb or of all, else defaults by their limits."""
    rows = {
        key: np.array([getattr(limb, key) for limb in spec.limbs], dtype=float)
        for key in ("max_torque", "max_joint_speed", "joint_stiffness")
    }
    inertia = default_rotor_inertia(rows["max_torque"], rows["max_joint_speed"])
    if spec.joint_rotor_inertia is not None:
        inertia = np.full_like(inertia, spec.joint_rotor_inertia)
    motor = rows["joint_stiffness"] * (1 - spec.structural_compliance_share)
    damping = default_damping(motor, inertia)
    if spec.joint_damping is not None:
        damping = np.full_like(damping, spec.joint_damping)
    none = np.zeros_like(inertia)
    return JointDynamics(inertia, damping, none, none)


def dynamics_of(robot: Robot) -> JointDynamics:
    """Return a robot's joint dynamics, by its limits where it has none (older plan files)."""
    if robot.dynamics is not None:
        return robot.dynamics
    inertia = default_rotor_inertia(robot.max_torque, robot.max_joint_speed)
    motor = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    none = np.zeros_like(inertia)
    return JointDynamics(inertia, default_damping(motor, inertia), none, none)
