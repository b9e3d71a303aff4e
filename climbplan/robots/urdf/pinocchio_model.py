"""A URDF as Pinocchio has it: joints, axes, toes and masses when all angles are zero.

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
from climbplan.robots.urdf.normal_document import normal_document
from climbplan.schema.document import Finding
from climbplan.schema.robots.urdf.mimics import follows
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.urdf.tree import UrdfLink

_HOLDER = 6  # coordinates of the free base, before those of the joints
_MASS_OFF = 1e-9  # relative, by which sums of masses may differ in rounding


def pinocchio() -> Any:
    """The library.

    Raises MissingSolver if it is not installed.
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
    slides: tuple[bool, ...]
    leaders: tuple[int, ...]  # (j,) the joint that each follows, itself if none
    ratios: tuple[float, ...]  # of their motions


@dataclass(frozen=True)
class UrdfModel:
    """A URDF in Pinocchio's hands."""

    robot: UrdfRobot
    library: Any
    model: Any
    turn: Array  # (3, 3) from the root's axes at zero to x right, y forward, z up
    origin: Array  # (3,) base link in the root's frame [m]

    def placed(self, points: Array) -> Array:
        """Points (..., 3) of the root's frame, from the base link and in its turned axes."""
        return np.asarray((points - self.origin) @ self.turn.T)

    def leg(self, name: str) -> LegAtZero:
        """One leg at zero angles."""
        pin, model = self.library, self.model
        data = self._data(self.angles({}))
        spec = self.robot.spec.legs[name]
        own = self.robot.joints[name]
        joints, axes = [], []
        for joint in own:
            index = model.getJointId(joint.name)
            frame = pin.ReferenceFrame.WORLD
            whole = pin.getJointJacobian(model, data, index, frame)[:, model.idx_vs[index]]
            column = whole[:3] if joint.slides else whole[3:]
            joints.append(data.oMi[index].translation)
            axes.append(column / np.linalg.norm(column))
        names = tuple(joint.name for joint in own)
        led = [follows(self.robot.tree, joint) for joint in own]
        toe = data.oMf[_frame(self, spec.toe)]
        point = toe.translation + toe.rotation @ np.array(spec.toe_offset, float)
        return LegAtZero(
            names,
            self.placed(np.array(joints)),
            np.array(axes) @ self.turn.T,
            self.placed(point),
            self.turn @ toe.rotation,
            tuple(joint.slides for joint in own),
            tuple(j if by is None else names.index(by.leader) for j, by in enumerate(led)),
            tuple(1.0 if by is None else by.ratio for by in led),
        )

    def mass(self) -> float:
        """Sum over the links [kg]."""
        return float(self.library.computeTotalMass(self.model))

    def center(self, angles: dict[str, float]) -> Array:
        """Centre of mass (3,) at joint angles by name [rad, m]; others are locked or at zero."""
        pin, model = self.library, self.model
        return self.placed(pin.centerOfMass(model, model.createData(), self.angles(angles)))

    def angles(self, given: dict[str, float]) -> Any:
        """Pinocchio's coordinates for joint angles by name [rad, m]; others are locked or at zero.

        Joints that follow others are where those put them, unless they are locked.
        """
        pin, model, tree = self.library, self.model, self.robot.tree
        locked = self.robot.spec.held
        turned = np.zeros(model.nv)
        known = locked | given
        for joint in tree.joints.values():
            by = follows(tree, joint)
            if by is not None and joint.name not in locked:
                known[joint.name] = by.ratio * known.get(by.leader, 0.0) + by.offset
        for name, angle in known.items():
            turned[model.idx_vs[model.getJointId(name)]] = angle
        return pin.integrate(model, pin.neutral(model), turned)

    def _data(self, q: Any) -> Any:
        pin, model = self.library, self.model
        data = model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        return data


def urdf_model(robot: UrdfRobot) -> UrdfModel:
    """The model of a robot section whose text was checked.

    Raises MissingSolver without Pinocchio, and SpecError for what Pinocchio refuses or reads in
    another way.
    """
    pin = pinocchio()
    try:
        model = pin.buildModelFromXML(normal_document(robot), pin.JointModelFreeFlyer())
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise robot.refused([Finding(("urdf",), f"Pinocchio cannot read it: {reason}")]) from error
    if lost := list(lost_masses(robot, model, pin)):
        raise robot.refused(lost)
    data = model.createData()
    forward, up = _axis(robot.spec.forward), _axis(robot.spec.up)
    to_axes = np.stack([np.cross(forward, up), forward, up])
    found = UrdfModel(robot, pin, model, to_axes, np.zeros(3))
    pin.forwardKinematics(model, data, found.angles({}))
    pin.updateFramePlacements(model, data)
    base = data.oMf[_frame(found, robot.base)]
    return UrdfModel(robot, pin, model, to_axes @ base.rotation.T, np.array(base.translation))


def lost_masses(robot: UrdfRobot, model: Any, pin: Any) -> Iterator[Finding]:
    """Where Pinocchio has another mass than the file: joint by joint, with the links it carries."""
    carried: dict[int, list[UrdfLink]] = {}
    for link in robot.tree.links.values():
        index = int(model.getFrameId(link.name, pin.FrameType.BODY))
        if index >= model.nframes:
            at = robot.tree.at(link.line)
            yield Finding(("urdf",), f"Pinocchio has no link {link.name!r} ({at})")
            continue
        carried.setdefault(int(model.frames[index].parentJoint), []).append(link)
    for joint, links in carried.items():
        expected = sum(link.mass for link in links)
        found = float(model.inertias[joint].mass)
        if not abs(found - expected) <= _MASS_OFF * max(expected, 1.0):
            names = " and ".join(f"{link.name!r} ({robot.tree.at(link.line)})" for link in links)
            message = f"Pinocchio has {found:g} kg for {names}, the file {expected:g} kg"
            yield Finding(("urdf",), message)


def _axis(name: str) -> Array:
    """Unit vector (3,) of `x`, `-x`, ..."""
    return np.eye(3)["xyz".index(name[-1])] * (-1.0 if name.startswith("-") else 1.0)


def _frame(found: UrdfModel, link: str) -> int:
    """Index of a link's frame; a joint may have the same name."""
    return int(found.model.getFrameId(link, found.library.FrameType.BODY))
