"""The MuJoCo model of a walk with the whole robot: all links of its URDF with mass and inertia.

Built from Pinocchio's reading of the URDF that the plan carries. The root body of the model has the
axes of walking (x forward, y left, z up) and its origin where the robot's root link has it; joints
of the legs move, all others are held where the robot file has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.robots.urdf.drives import joint_dynamics_of
from climbplan.robots.urdf.pinocchio_model import UrdfModel, urdf_model
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.kinds import validate
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.simulation.attributes import inertial_of, numbers
from climbplan.simulation.conditions import Conditions
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.schema.loading import stored_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.simulation.model import (
    BODY,
    TOE,
    TOE_RADIUS,
    ground_of,
    world_of,
)

_ROOT = 1  # of Pinocchio's joints: the free one
_THICK = 0.1  # of a link's length, as it is drawn
_STIFF = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'
_HALF_HEIGHT = 0.04  # [m] of the body, which falls on the ground


@dataclass(frozen=True)
class WholeRobot:
    """A robot that walks, link by link."""

    found: UrdfModel
    centre: Array  # (3,) of mass of the standing robot, from the root body in its axes [m]
    mjcf: str  # of its bodies
    ties: str  # of joints that mimic others
    mass: float  # [kg]


def whole_robot(plan: WalkPlan, conditions: Conditions) -> WholeRobot:
    """The robot of a plan, from the texts that it carries.

    Raises UsageError for a plan of a robot without links, MissingSolver without Pinocchio.
    """
    found = urdf_model(robot_of_plan(plan))
    legs = plan.task.legs
    assert legs is not None  # a robot from a URDF has them
    turn = TO_WALKING @ found.turn  # from the root's axes to walking's
    angles = {
        name: float(angle)
        for own, row in zip(legs.chain.names, legs.chain.posture, strict=True)
        for name, angle in zip(own, row, strict=True)
        if name
    }
    pin, model = found.library, found.model
    centre = turn @ np.array(pin.centerOfMass(model, model.createData(), found.angles(angles)))
    tree = _Tree(found, plan, turn, conditions, centre)
    return WholeRobot(found, centre, tree.body(), ties_of(legs), found.mass())


def whole_model(plan: WalkPlan, robot: WholeRobot, conditions: Conditions) -> str:
    """The model of a walk by the whole robot; toes are centres of spheres on lowered ground."""
    lower = sphere_radius(robot.found.robot)
    return world_of(plan, ground_of(plan, conditions, lower), robot.mjcf, robot.ties)


def sphere_radius(robot: UrdfRobot) -> float:
    """Radius of the spheres about the toes [m]: of its feet, where it has spherical ones."""
    return robot.spec.foot_radius or TOE_RADIUS


def ties_of(legs: WalkingLegs) -> str:
    """What moves joints that mimic others."""
    drive, ties = legs.chain.drives, []
    for leg, joint in np.argwhere(legs.mimics):
        leader = int(np.argmax(np.abs(drive[leg, joint])))
        ties.append(
            f'<joint joint1="{leg}_{joint}" joint2="{leg}_{leader}" '
            f'polycoef="0 {drive[leg, joint, leader]:.12g} 0 0 0" {_STIFF}/>'
        )
    return "".join(ties)


def robot_of_plan(plan: WalkPlan) -> UrdfRobot:
    """The robot from a URDF that a plan carries; raises UsageError for any other."""
    spec, _ = validate(parse_yaml(plan.spec_text, "spec"), MpcSpec)
    robot = None if spec is None else stored_body(spec, plan.robot_text, plan.robot_urdf)
    if not isinstance(robot, UrdfRobot):
        raise UsageError(f"{plan.name}: its robot is one rigid body, without links")
    return robot


def _resistance(found: UrdfModel, conditions: Conditions) -> dict[str, str]:
    """Attributes of each leg's joints, by name: rotor inertia and friction.

    Joints that mimic others have no motor, and so no rotor.
    """
    robot = found.robot
    names = [tuple(joint.name for joint in joints) for joints in robot.joints.values()]
    width = max(map(len, names))
    own, out = joint_dynamics_of(robot, names, width), {}
    for leg, joints in enumerate(names):
        for number, name in enumerate(joints, start=width - len(joints)):
            rotor = conditions.armature * own.rotor_inertia[leg, number]
            if conditions.armature_value is not None:
                rotor = conditions.armature_value
            if robot.tree.joints[name].mimic is not None:
                rotor = 0.0
            out[name] = (
                f' armature="{rotor:.9g}" damping="{own.viscous_friction[leg, number]:.9g}"'
                f' frictionloss="{own.dry_friction[leg, number]:.9g}"'
            )
    return out


class _Tree:
    """Bodies of the model, from the root on."""

    def __init__(
        self, found: UrdfModel, plan: WalkPlan, turn: Array, conditions: Conditions, centre: Array
    ) -> None:
        assert plan.task.legs is not None
        self.found, self.turn, self.centre = found, turn, centre
        self.payload = conditions.payload
        self.resistance = _resistance(found, conditions)
        self.legs = plan.task.legs
        self.half = np.abs(plan.task.body.toe_center).max(axis=0)
        pin, model = found.library, found.model
        self.data = model.createData()
        q = found.angles({})
        pin.computeJointJacobians(model, self.data, q)
        pin.updateFramePlacements(model, self.data)
        self.turning = {
            name: (leg, j)
            for leg, own in enumerate(self.legs.chain.names)
            for j, name in enumerate(own)
            if name
        }
        self.children: dict[int, list[int]] = {}
        for joint in range(_ROOT + 1, model.njoints):
            self.children.setdefault(int(model.parents[joint]), []).append(joint)

    def body(self) -> str:
        inertia = self.found.model.inertias[_ROOT]
        lever = self.turn @ np.array(inertia.lever)
        about = self.turn @ np.array(inertia.inertia) @ self.turn.T
        mass, extra = float(inertia.mass), ""
        if self.payload:
            extra = (
                f'<body pos="{numbers(self.centre)}"><inertial pos="0 0 0"'
                f' mass="{self.payload:.9g}" diaginertia="1e-6 1e-6 1e-6"/></body>'
            )
        own = inertial_of(mass, lever, about, "the body")
        half = [0.5 * self.half[0], 0.35 * self.half[1], _HALF_HEIGHT]
        below = "".join(self._link(child, self.turn) for child in self.children.get(_ROOT, []))
        return (
            f'<body name="body"><freejoint name="free"/>{own}'
            f'<geom name="body" type="box" pos="{numbers(self.centre)}" size="{numbers(half)}"'
            f' mass="0" material="body" contype="{BODY}" conaffinity="0"/>{extra}{below}</body>'
        )

    def _link(self, joint: int, turn: Array) -> str:
        """A body that a joint moves; turn: from the parent's axes in Pinocchio to the model's."""
        pin, model = self.found.library, self.found.model
        place, name = self.data.liMi[joint], str(model.names[joint])
        rotation = turn @ np.array(place.rotation)
        quat = pin.Quaternion(rotation)
        inertia = model.inertias[joint]
        hinge, toe = "", ""
        if name in self.turning:
            leg, number = self.turning[name]
            whole = np.array(
                pin.getJointJacobian(model, self.data, joint, pin.ReferenceFrame.LOCAL)
            )[:, int(model.idx_vs[joint])]
            slides = bool(self.legs.chain.sliding[leg, number])
            kind, column = ("slide", whole[:3]) if slides else ("hinge", whole[3:])
            low, high = self.legs.lower[leg, number], self.legs.upper[leg, number]
            bounds = f' range="{low:.9g} {high:.9g}" limited="true"'
            if self.legs.mimics[leg, number]:
                bounds = ""  # those of the joint that it follows
            hinge = (
                f'<joint name="{leg}_{number}" type="{kind}" axis="{numbers(column)}"{bounds}'
                f"{self.resistance[name]}/>"
            )
            toe = self._toe(leg, joint) if number == self.legs.chain.joint_count - 1 else ""
        below = "".join(self._link(child, np.eye(3)) for child in self.children.get(joint, []))
        drawn = "".join(
            self._drawn(np.array(self.data.liMi[child].translation))
            for child in self.children.get(joint, [])
        )
        lever, about = np.array(inertia.lever), np.array(inertia.inertia)
        own = inertial_of(float(inertia.mass), lever, about, f"the link moved by {name}")
        at = turn @ np.array(place.translation)
        return (
            f'<body pos="{numbers(at)}" quat="{quat.w:.12g} {quat.x:.12g} {quat.y:.12g}'
            f' {quat.z:.12g}">{own}{hinge}{drawn}{toe}{below}</body>'
        )

    def _toe(self, leg: int, joint: int) -> str:
        name = list(self.found.robot.spec.legs)
        names = [self.found.robot.joints[n] for n in name]
        own = next(
            n
            for n, joints in zip(name, names, strict=True)
            if joints[-1].name == self.legs.chain.names[leg][-1]
        )
        spec = self.found.robot.spec.legs[own]
        model = self.found.model
        frame = model.frames[int(model.getFrameId(spec.toe, self.found.library.FrameType.BODY))]
        place = frame.placement
        point = np.array(place.translation) + np.array(place.rotation) @ np.array(spec.toe_offset)
        return (
            f'{self._drawn(point)}<geom name="toe{leg}" type="sphere" pos="{numbers(point)}"'
            f' size="{sphere_radius(self.found.robot)}" mass="0" material="toe" friction="0 0 0"'
            f' contype="{TOE}" conaffinity="0"/><site name="toe{leg}" pos="{numbers(point)}"/>'
        )

    def _drawn(self, end: Array) -> str:
        """A link as it is seen; nothing touches it."""
        length = float(np.linalg.norm(end))
        if length < 1e-3:
            return ""
        return (
            f'<geom type="capsule" fromto="0 0 0 {numbers(end)}"'
            f' size="{_THICK * length:.4g}" mass="0"'
            ' rgba="0.35 0.55 0.80 1" contype="0" conaffinity="0"/>'
        )
