"""Masses, centres and inertias of a URDF's links, joint by joint of the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import UrdfModel


def compute_link_masses(
    urdf_model: UrdfModel, chain: SerialChain, centre: Array, mass: float
) -> LinkMasses:
    """Return the links of a URDF's legs; locked joints and fixed links count to what carries them.

    Args:
        urdf_model: The robot.
        chain: Its legs, about the body's origin.
        centre: That origin (3,) from the base link [m].
        mass: Of the whole robot [kg]. The difference from the URDF's acts in the origin, the centre
            of mass of the posture.
    """
    by_joint = _collect_rigid_parts(urdf_model)
    shape = chain.posture.shape
    masses, centers, inertia = np.zeros(shape), np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
    for limb, names in enumerate(chain.names):
        for joint, name in enumerate(names):
            if not name:
                continue
            rigid_part = by_joint.pop(name)
            masses[limb, joint], inertia[limb, joint] = rigid_part.mass, rigid_part.inertia
            if rigid_part.mass > 0:
                centers[limb, joint] = rigid_part.middle - centre - chain.joint_zero[limb, joint]
    base = by_joint[""]
    body = mass - float(masses.sum())
    moment = base.mass * (base.middle - centre)
    body_center = moment / body if body > 0 else np.zeros(3)
    return LinkMasses(masses, centers, inertia, body, body_center, base.inertia)


@dataclass(frozen=True)
class _RigidPart:
    """A rigid part; base frame turned to x right, y forward, z up."""

    mass: float
    middle: Array  # (3,) [m]
    inertia: Array  # (3, 3) about it


def _collect_rigid_parts(urdf_model: UrdfModel) -> dict[str, _RigidPart]:
    """Return rigid parts by the joint of a leg that carries them, "" for the body.

    All angles are zero or locked.
    """
    pin, model = urdf_model.library, urdf_model.model
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_model.build_configuration({}))
    leg_joints = {joint.name for leg in urdf_model.robot.joints.values() for joint in leg}
    by_joint: dict[str, _RigidPart] = {}
    for index in range(1, model.njoints):
        carrier = index
        while carrier > 1 and model.names[carrier] not in leg_joints:
            carrier = int(model.parents[carrier])
        name = str(model.names[carrier]) if carrier > 1 else ""
        inertia = data.oMi[index].act(model.inertias[index])
        rigid_part = _RigidPart(
            float(inertia.mass),
            urdf_model.to_base_axes(np.array(inertia.lever)),
            urdf_model.root_to_base_rotation
            @ np.array(inertia.inertia)
            @ urdf_model.root_to_base_rotation.T,
        )
        by_joint[name] = (
            _merge_parts(by_joint[name], rigid_part) if name in by_joint else rigid_part
        )
    return by_joint


def _merge_parts(first: _RigidPart, second: _RigidPart) -> _RigidPart:
    mass = first.mass + second.mass
    if mass <= 0:
        return first
    middle = (first.mass * first.middle + second.mass * second.middle) / mass
    inertia = first.inertia + second.inertia
    for summand in (first, second):
        offset = summand.middle - middle
        inertia = inertia + summand.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return _RigidPart(mass, middle, inertia)
