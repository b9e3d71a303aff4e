"""The root link of the URDF that a plan's robot comes from: where it is, and what a URDF adds.

Plans move a body frame of their own, with its origin in the centre of mass and axes by which the
robot walks or climbs. Other simulators place the root link of the URDF, from which all else hangs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.exports.motion import BodyMotion, unwrap_quaternions
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.schema.robots.urdf.mimics import resolve_mimic
from climbplan.schema.robots.urdf.robot import UrdfRobot

_AGREE = 1e-6  # [m] by which joints of the plan and of its URDF may be apart


@dataclass(frozen=True)
class BaseLink:
    """The root link of a URDF in the body frame of a plan."""

    name: str
    position: Array  # (3,) of its frame's origin, body frame [m]
    rotation: Array  # (3, 3) root link to body

    def motion(self, position: Array, rotation: Array) -> BodyMotion:
        """Return the link's motion for a body that moves.

        Args:
            position: (T, 3) origin of the body [m], world frame.
            rotation: (T, 3, 3) body to world.
        """
        quaternion = Rotation.from_matrix(rotation @ self.rotation).as_quat()
        return BodyMotion(
            self.name, position + rotation @ self.position, unwrap_quaternions(quaternion)
        )


def build_base_link(robot: UrdfRobot, chain: SerialChain, axes: Array) -> BaseLink:
    """Return the root link of a robot's URDF in the body frame of a plan.

    Args:
        robot: The robot section with its URDF.
        chain: The limbs as the plan has them, body frame.
        axes: (3, 3) from climbing's body axes (x right, y forward) to those of `chain`.

    Raises:
        MissingSolver: Pinocchio is not installed.
        ValueError: The limbs of the plan are not those of its URDF.
    """
    model = build_urdf_model(robot)
    offset = _locate_origin(model, chain, axes)
    root_rotation = axes @ model.root_to_base_rotation
    return BaseLink(
        name=robot.tree.roots[0],
        position=offset - root_rotation @ model.base_origin,
        rotation=root_rotation,
    )


def _locate_origin(model: UrdfModel, chain: SerialChain, axes: Array) -> Array:
    """Return (3,) origin of the link that is the body, in the body frame: from where its joints
    are.
    """
    places = {
        name: point
        for limb in model.robot.limb_names
        for leg in (model.read_leg(limb),)
        for name, point in zip(leg.names, leg.joints, strict=True)
    }
    joint_points = [
        (name, chain.joint_zero[limb, j])
        for limb, names in enumerate(chain.names)
        for j, name in enumerate(names)
        if name
    ]
    if missing := [name for name, _ in joint_points if name not in places]:
        raise ValueError(f"its URDF has no joints {', '.join(missing)} in its legs")
    offsets = np.array([point - axes @ places[name] for name, point in joint_points])
    deviation = float(np.ptp(offsets, axis=0).max())
    if deviation > _AGREE:
        raise ValueError(
            f"joints of {model.robot.name} in the plan are not where its URDF has them, "
            f"{1e3 * deviation:.3g} mm off"
        )
    return np.asarray(offsets.mean(axis=0))


def collect_urdf_facts(robot: UrdfRobot) -> Mapping[str, object]:
    """Return what a simulator of the URDF has to know of the robot file: held and mimic joints,
    toes.
    """
    mimics = {}
    for joint in robot.tree.joints.values():
        coupling = resolve_mimic(robot.tree, joint)
        if coupling is not None and joint.name not in robot.spec.locked_positions:
            mimics[joint.name] = {
                "joint": coupling.leader,
                "multiplier": coupling.ratio,
                "offset": coupling.offset,
            }
    return {
        "base_link": robot.tree.roots[0],
        "held_joints": dict(robot.spec.locked_positions),
        "mimic_joints": mimics,
        "toes": {
            name: {"link": leg.toe, "offset": [float(x) for x in leg.toe_offset]}
            for name, leg in robot.spec.legs.items()
        },
    }
