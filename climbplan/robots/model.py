"""A robot as arrays: what kinematics and mechanics compute with."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.robots.gripper import Gripper
from climbplan.robots.rotations import Array
from climbplan.spec.robot import RobotSpec


@dataclass(frozen=True)
class Robot:
    """N limbs with coxa, femur and tibia on a rigid body; body frame x right, y forward, z up."""

    name: str
    mass: float  # [kg], acts at the body origin
    gravity: float  # [m/s^2]
    structural_compliance_share: float  # part of the limb compliance beside the joints'
    limb_names: tuple[str, ...]
    sides: tuple[str, ...]  # "left", "right" or "any"
    shoulder_body: Array  # (N, 3) first joint [m]
    mount_yaw: Array  # (N,) direction of the coxa at zero angle [rad]
    link_lengths: Array  # (N, 3) coxa, femur, tibia [m]
    max_torque: Array  # (N, 3) [N m]
    joint_stiffness: Array  # (N, 3) [N m/rad]
    joint_lower: Array  # (N, 3) [rad]
    joint_upper: Array  # (N, 3) [rad]
    max_joint_speed: Array  # (N, 3) [rad/s]
    stance_body: Array  # (N, 3) nominal toe positions [m]
    body_hull: Array  # (8, 3) corners of the body's box [m]
    reach: float  # Delta_FK, largest shoulder-toe distance of the posture planner [m]
    stance_radius: float  # largest toe distance from its stance in the posture planner [m]
    limb_radius: float  # capsule radius of the links [m]
    gripper: Gripper | None = None  # on a wrist at every toe

    @property
    def limb_count(self) -> int:
        """N."""
        return len(self.limb_names)

    @property
    def weight(self) -> float:
        """Mass times gravity [N]."""
        return self.mass * self.gravity

    @classmethod
    def from_spec(cls, spec: RobotSpec) -> Self:
        """The arrays of a validated robot spec."""
        limbs = spec.limbs

        def rows(attribute: str) -> Array:
            return np.array([getattr(limb, attribute) for limb in limbs], dtype=float)

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
            gripper=None if spec.gripper is None else Gripper.from_spec(spec.gripper),
        )
