"""The MuJoCo model of a walk with the whole robot: all links of its URDF with mass and inertia.

It is built from Pinocchio's model of the URDF that the plan contains. The root body has the axes
of walking (x forward, y left, z up) and its origin at the robot's root link. Joints of the legs
move; all others are fixed as the robot file has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.robots.urdf.drives import read_joint_dynamics
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.kinds import validate
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.simulation.attributes import format_numbers, write_inertial
from climbplan.simulation.conditions import Conditions
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.schema.loading import load_stored_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.simulation.mujoco_model import (
    BODY_CONTACT,
    TOE_CONTACT,
    TOE_RADIUS,
    build_ground_mjcf,
    build_world_mjcf,
)

_ROOT_JOINT = 1  # index of Pinocchio's free joint
_LINK_THICKNESS = 0.1  # radius of drawn links, as a fraction of their length
_STIFF_EQUALITY = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'
_HALF_HEIGHT = 0.04  # [m] of the body's collision box


@dataclass(frozen=True)
class WholeBodyRobot:
    """A walking robot with all its links."""

    urdf_model: UrdfModel
    centre: Array  # (3,) of mass of the standing robot, from the root body in its axes [m]
    mjcf: str  # bodies
    ties: str  # equality constraints of joints that mimic others
    mass: float  # [kg]


def build_whole_body_robot(plan: WalkPlan, conditions: Conditions) -> WholeBodyRobot:
    """Build the robot of a plan from the texts that the plan contains.

    Raises:
        UsageError: a plan of a robot without links.
        MissingSolver: Pinocchio is not installed.
    """
    urdf_model = build_urdf_model(read_plan_robot(plan))
    legs = plan.task.legs
    assert legs is not None  # as the robot is from a URDF
    to_walking = TO_WALKING @ urdf_model.root_to_base_rotation  # from the root link's axes
    angles = {
        name: float(angle)
        for names, row in zip(legs.chain.names, legs.chain.posture, strict=True)
        for name, angle in zip(names, row, strict=True)
        if name
    }
    pin, model = urdf_model.library, urdf_model.model
    centre = to_walking @ np.array(
        pin.centerOfMass(model, model.createData(), urdf_model.build_configuration(angles))
    )
    tree = _BodyTree(urdf_model, plan, to_walking, conditions, centre)
    return WholeBodyRobot(
        urdf_model,
        centre,
        tree.build_root(),
        build_joint_equalities(legs),
        urdf_model.compute_mass(),
    )


def build_whole_body_mjcf(plan: WalkPlan, robot: WholeBodyRobot, conditions: Conditions) -> str:
    """Build the model of a walk by the whole robot; spherical feet stand on lowered terrain."""
    lower = foot_sphere_radius(robot.urdf_model.robot)
    return build_world_mjcf(
        plan, build_ground_mjcf(plan, conditions, lower), robot.mjcf, robot.ties
    )


def foot_sphere_radius(robot: UrdfRobot) -> float:
    """Return the radius of the spheres about the toes [m]."""
    return robot.spec.foot_radius or TOE_RADIUS


def build_joint_equalities(legs: WalkingLegs) -> str:
    """Build the equality constraints of joints that mimic others."""
    drive, ties = legs.chain.drives, []
    for leg, joint in np.argwhere(legs.mimics):
        leader = int(np.argmax(np.abs(drive[leg, joint])))
        ties.append(
            f'<joint joint1="{leg}_{joint}" joint2="{leg}_{leader}" '
            f'polycoef="0 {drive[leg, joint, leader]:.12g} 0 0 0" {_STIFF_EQUALITY}/>'
        )
    return "".join(ties)


def read_plan_robot(plan: WalkPlan) -> UrdfRobot:
    """Read the URDF robot of a plan.

    Raises:
        UsageError: the robot is no URDF robot.
    """
    spec, _ = validate(parse_yaml(plan.spec_text, "spec"), MpcSpec)
    robot = None if spec is None else load_stored_body(spec, plan.robot_text, plan.robot_urdf)
    if not isinstance(robot, UrdfRobot):
        raise UsageError(f"{plan.name}: its robot is one rigid body, without links")
    return robot


def _read_joint_resistance(urdf_model: UrdfModel, conditions: Conditions) -> dict[str, str]:
    """Return attributes of each leg's joints, by name: rotor inertia and friction.

    Joints that mimic others have no motor and therefore no rotor.
    """
    robot = urdf_model.robot
    names = [tuple(joint.name for joint in joints) for joints in robot.joints.values()]
    width = max(map(len, names))
    dynamics, attributes = read_joint_dynamics(robot, names, width), {}
    for leg, joints in enumerate(names):
        for number, name in enumerate(joints, start=width - len(joints)):
            rotor = conditions.armature * dynamics.rotor_inertia[leg, number]
            if conditions.armature_value is not None:
                rotor = conditions.armature_value
            if robot.tree.joints[name].mimic is not None:
                rotor = 0.0
            attributes[name] = (
                f' armature="{rotor:.9g}" damping="{dynamics.viscous_friction[leg, number]:.9g}"'
                f' frictionloss="{dynamics.dry_friction[leg, number]:.9g}"'
            )
    return attributes


class _BodyTree:
    """Builds the bodies of the model from the root on."""

    def __init__(
        self,
        urdf_model: UrdfModel,
        plan: WalkPlan,
        to_walking: Array,
        conditions: Conditions,
        centre: Array,
    ) -> None:
        assert plan.task.legs is not None
        self.urdf_model, self.to_walking, self.centre = urdf_model, to_walking, centre
        self.payload = conditions.payload
        self.resistance = _read_joint_resistance(urdf_model, conditions)
        self.legs = plan.task.legs
        self.half = np.abs(plan.task.body.toe_center).max(axis=0)
        pin, model = urdf_model.library, urdf_model.model
        self.data = model.createData()
        q = urdf_model.build_configuration({})
        pin.computeJointJacobians(model, self.data, q)
        pin.updateFramePlacements(model, self.data)
        self.leg_joints = {
            name: (leg, j)
            for leg, names in enumerate(self.legs.chain.names)
            for j, name in enumerate(names)
            if name
        }
        self.children: dict[int, list[int]] = {}
        for joint in range(_ROOT_JOINT + 1, model.njoints):
            self.children.setdefault(int(model.parents[joint]), []).append(joint)

    def build_root(self) -> str:
        """Build the root body with its free joint."""
        inertia = self.urdf_model.model.inertias[_ROOT_JOINT]
        lever = self.to_walking @ np.array(inertia.lever)
        rotated_inertia = self.to_walking @ np.array(inertia.inertia) @ self.to_walking.T
        mass, payload = float(inertia.mass), ""
        if self.payload:
            payload = (
                f'<body pos="{format_numbers(self.centre)}"><inertial pos="0 0 0"'
                f' mass="{self.payload:.9g}" diaginertia="1e-6 1e-6 1e-6"/></body>'
            )
        inertial = write_inertial(mass, lever, rotated_inertia, "the body")
        half = [0.5 * self.half[0], 0.35 * self.half[1], _HALF_HEIGHT]
        children = "".join(
            self._build_link(child, self.to_walking) for child in self.children.get(_ROOT_JOINT, [])
        )
        return (
            f'<body name="body"><freejoint name="free"/>{inertial}'
            f'<geom name="body" type="box" pos="{format_numbers(self.centre)}"'
            f' size="{format_numbers(half)}" mass="0" material="body"'
            f' contype="{BODY_CONTACT}" conaffinity="0"/>'
            f"{payload}{children}</body>"
        )

    def _build_link(self, joint: int, to_model: Array) -> str:
        """Build the body that a joint moves; to_model: rotation from Pinocchio's parent axes."""
        pin, model = self.urdf_model.library, self.urdf_model.model
        place, name = self.data.liMi[joint], str(model.names[joint])
        rotation = to_model @ np.array(place.rotation)
        quat = pin.Quaternion(rotation)
        inertia = model.inertias[joint]
        hinge, toe = "", ""
        if name in self.leg_joints:
            leg, number = self.leg_joints[name]
            motion = np.array(
                pin.getJointJacobian(model, self.data, joint, pin.ReferenceFrame.LOCAL)
            )[:, int(model.idx_vs[joint])]
            slides = bool(self.legs.chain.sliding[leg, number])
            kind, column = ("slide", motion[:3]) if slides else ("hinge", motion[3:])
            low, high = self.legs.lower[leg, number], self.legs.upper[leg, number]
            bounds = f' range="{low:.9g} {high:.9g}" limited="true"'
            if self.legs.mimics[leg, number]:
                bounds = ""  # the followed joint has them
            hinge = (
                f'<joint name="{leg}_{number}" type="{kind}" axis="{format_numbers(column)}"'
                f"{bounds}{self.resistance[name]}/>"
            )
            toe = self._build_toe(leg, joint) if number == self.legs.chain.joint_count - 1 else ""
        children = "".join(
            self._build_link(child, np.eye(3)) for child in self.children.get(joint, [])
        )
        visuals = "".join(
            self._build_visual(np.array(self.data.liMi[child].translation))
            for child in self.children.get(joint, [])
        )
        lever, inertia_matrix = np.array(inertia.lever), np.array(inertia.inertia)
        inertial = write_inertial(
            float(inertia.mass), lever, inertia_matrix, f"the link moved by {name}"
        )
        position = to_model @ np.array(place.translation)
        return (
            f'<body pos="{format_numbers(position)}" quat="{quat.w:.12g} {quat.x:.12g} '
            f'{quat.y:.12g} {quat.z:.12g}">{inertial}{hinge}{visuals}{toe}{children}</body>'
        )

    def _build_toe(self, leg: int, joint: int) -> str:
        """Build the sphere and the site of a toe."""
        leg_names = list(self.urdf_model.robot.spec.legs)
        leg_joints = [self.urdf_model.robot.joints[n] for n in leg_names]
        leg_name = next(
            n
            for n, joints in zip(leg_names, leg_joints, strict=True)
            if joints[-1].name == self.legs.chain.names[leg][-1]
        )
        spec = self.urdf_model.robot.spec.legs[leg_name]
        model = self.urdf_model.model
        frame = model.frames[
            int(model.getFrameId(spec.toe, self.urdf_model.library.FrameType.BODY))
        ]
        place = frame.placement
        point = np.array(place.translation) + np.array(place.rotation) @ np.array(spec.toe_offset)
        return (
            f'{self._build_visual(point)}<geom name="toe{leg}" type="sphere"'
            f' pos="{format_numbers(point)}"'
            f' size="{foot_sphere_radius(self.urdf_model.robot)}" mass="0" material="toe"'
            f' friction="0 0 0" contype="{TOE_CONTACT}" conaffinity="0"/>'
            f'<site name="toe{leg}" pos="{format_numbers(point)}"/>'
        )

    def _build_visual(self, end: Array) -> str:
        """Build the visual geometry of a link, without contact."""
        length = float(np.linalg.norm(end))
        if length < 1e-3:
            return ""
        return (
            f'<geom type="capsule" fromto="0 0 0 {format_numbers(end)}"'
            f' size="{_LINK_THICKNESS * length:.4g}" mass="0"'
            ' rgba="0.35 0.55 0.80 1" contype="0" conaffinity="0"/>'
        )
