"""The Pinocchio model of a URDF: joints, axes, toes and masses when all angles are zero.

Pinocchio is an optional part (`pip install 'climbplan[urdf]'`), imported only when a URDF is read.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import MissingSolver
from climbplan.robots.urdf.canonical_urdf import write_canonical_urdf
from climbplan.schema.document import Finding
from climbplan.schema.robots.urdf.mimics import resolve_mimic
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.urdf.tree import UrdfLink

_BASE_DOFS = 6  # coordinates of the free base, before those of the joints
_MASS_TOLERANCE = 1e-9  # relative, between sums of masses


def import_pinocchio() -> Any:
    """Return the library.

    Raises:
        MissingSolver: It is not installed.
    """
    try:
        return importlib.import_module("pinocchio")
    except ImportError as error:
        raise MissingSolver(
            "a robot from a URDF needs Pinocchio, which is not installed: "
            "pip install 'climbplan[urdf]'"
        ) from error


@dataclass(frozen=True)
class LegAtZero:
    """One leg with all angles at zero, base frame turned to x right, y forward, z up."""

    names: tuple[str, ...]  # of its joints, from base to toe
    joints: Array  # (j, 3) [m]
    axes: Array  # (j, 3) unit, of joints that slide their directions
    toe: Array  # (3,) [m]
    toe_axes: Array  # (3, 3) columns x, y, z of the toe's link
    slides: tuple[bool, ...]  # (j,) whether it is prismatic
    leaders: tuple[int, ...]  # (j,) the joint that each mimics, itself if none
    ratios: tuple[float, ...]  # of their motions


@dataclass(frozen=True)
class UrdfModel:
    """A URDF as a Pinocchio model."""

    robot: UrdfRobot
    library: Any
    model: Any
    root_to_base_rotation: Array  # (3, 3) from the root's axes at zero to x right, y forward, z up
    base_origin: Array  # (3,) base link in the root's frame [m]

    def to_base_axes(self, points: Array) -> Array:
        """Return points (..., 3) of the root's frame in the turned axes of the base link."""
        return np.asarray((points - self.base_origin) @ self.root_to_base_rotation.T)

    def read_leg(self, name: str) -> LegAtZero:
        """Return one leg at zero angles."""
        pin, model = self.library, self.model
        data = self._compute_kinematics(self.build_configuration({}))
        spec = self.robot.spec.legs[name]
        leg_joints = self.robot.joints[name]
        joints, axes = [], []
        for joint in leg_joints:
            index = model.getJointId(joint.name)
            frame = pin.ReferenceFrame.WORLD
            whole = pin.getJointJacobian(model, data, index, frame)[:, model.idx_vs[index]]
            column = whole[:3] if joint.slides else whole[3:]
            joints.append(data.oMi[index].translation)
            axes.append(column / np.linalg.norm(column))
        names = tuple(joint.name for joint in leg_joints)
        mimics = [resolve_mimic(self.robot.tree, joint) for joint in leg_joints]
        toe = data.oMf[_find_frame(self, spec.toe)]
        point = toe.translation + toe.rotation @ np.array(spec.toe_offset, float)
        return LegAtZero(
            names,
            self.to_base_axes(np.array(joints)),
            np.array(axes) @ self.root_to_base_rotation.T,
            self.to_base_axes(point),
            self.root_to_base_rotation @ toe.rotation,
            tuple(joint.slides for joint in leg_joints),
            tuple(
                j if mimic is None else names.index(mimic.leader) for j, mimic in enumerate(mimics)
            ),
            tuple(1.0 if mimic is None else mimic.ratio for mimic in mimics),
        )

    def compute_mass(self) -> float:
        """Return the sum of the masses of all links [kg]."""
        return float(self.library.computeTotalMass(self.model))

    def compute_center(self, angles: dict[str, float]) -> Array:
        """Return the centre of mass (3,) at joint angles by name [rad, m], turned base frame [m].

        Other joints are locked or at zero.
        """
        pin, model = self.library, self.model
        return self.to_base_axes(
            pin.centerOfMass(model, model.createData(), self.build_configuration(angles))
        )

    def build_configuration(self, joint_angles: dict[str, float]) -> Any:
        """Return Pinocchio's configuration for joint angles by name [rad, m].

        Other joints are locked or at zero. Joints that mimic others follow them unless they are
        locked.
        """
        pin, model, tree = self.library, self.model, self.robot.tree
        locked = self.robot.spec.locked_positions
        velocity = np.zeros(model.nv)
        angles = locked | joint_angles
        for joint in tree.joints.values():
            mimic = resolve_mimic(tree, joint)
            if mimic is not None and joint.name not in locked:
                angles[joint.name] = mimic.ratio * angles.get(mimic.leader, 0.0) + mimic.offset
        for name, angle in angles.items():
            velocity[model.idx_vs[model.getJointId(name)]] = angle
        return pin.integrate(model, pin.neutral(model), velocity)

    def _compute_kinematics(self, q: Any) -> Any:
        pin, model = self.library, self.model
        data = model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        return data


def build_urdf_model(robot: UrdfRobot) -> UrdfModel:
    """Build the model of a robot section whose text was checked.

    Raises:
        MissingSolver: Pinocchio is not installed.
        SpecError: Pinocchio refuses the URDF or reads it in another way.
    """
    pin = import_pinocchio()
    try:
        model = pin.buildModelFromXML(write_canonical_urdf(robot), pin.JointModelFreeFlyer())
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise robot.build_error(
            [Finding(("urdf",), f"Pinocchio cannot read it: {reason}")]
        ) from error
    if mismatches := list(find_mass_mismatches(robot, model, pin)):
        raise robot.build_error(mismatches)
    data = model.createData()
    forward, up = _parse_axis(robot.spec.forward), _parse_axis(robot.spec.up)
    to_axes = np.stack([np.cross(forward, up), forward, up])
    unplaced = UrdfModel(robot, pin, model, to_axes, np.zeros(3))
    pin.forwardKinematics(model, data, unplaced.build_configuration({}))
    pin.updateFramePlacements(model, data)
    base = data.oMf[_find_frame(unplaced, robot.base)]
    return UrdfModel(robot, pin, model, to_axes @ base.rotation.T, np.array(base.translation))


def find_mass_mismatches(robot: UrdfRobot, model: Any, pin: Any) -> Iterator[Finding]:
    """Yield a finding for each joint whose carried mass in Pinocchio differs from the file's."""
    carried: dict[int, list[UrdfLink]] = {}
    for link in robot.tree.links.values():
        index = int(model.getFrameId(link.name, pin.FrameType.BODY))
        if index >= model.nframes:
            place = robot.tree.format_location(link.line)
            yield Finding(("urdf",), f"Pinocchio has no link {link.name!r} ({place})")
            continue
        carried.setdefault(int(model.frames[index].parentJoint), []).append(link)
    for joint, links in carried.items():
        expected = sum(link.mass for link in links)
        mass = float(model.inertias[joint].mass)
        if not abs(mass - expected) <= _MASS_TOLERANCE * max(expected, 1.0):
            names = " and ".join(
                f"{link.name!r} ({robot.tree.format_location(link.line)})" for link in links
            )
            message = f"Pinocchio has {mass:g} kg for {names}, the file {expected:g} kg"
            yield Finding(("urdf",), message)


def _parse_axis(name: str) -> Array:
    """Return the unit vector (3,) of `x`, `-x`, ..."""
    return np.eye(3)["xyz".index(name[-1])] * (-1.0 if name.startswith("-") else 1.0)


def _find_frame(urdf_model: UrdfModel, link: str) -> int:
    """Return the index of a link's frame; a joint may have the same name."""
    return int(urdf_model.model.getFrameId(link, urdf_model.library.FrameType.BODY))
