"""Masses, centres and inertias of a URDF's links, joint by joint of the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import UrdfModel


def link_masses_of(found: UrdfModel, chain: SerialChain, centre: Array, mass: float) -> LinkMasses:
    """Links of a URDF's legs; held joints and fixed links count to what they move with.

    chain: about the body's origin, which is at `centre` (3,) from the base link. mass: of the whole
    robot; what it is beside the URDF's acts in that origin, the centre of mass of the posture.
    """
    parts = _parts(found)
    shape = chain.posture.shape
    masses, middle, inertia = np.zeros(shape), np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
    for limb, own in enumerate(chain.names):
        for joint, name in enumerate(own):
            if not name:
                continue
            part = parts.pop(name)
            masses[limb, joint], inertia[limb, joint] = part.mass, part.inertia
            if part.mass > 0:
                middle[limb, joint] = part.middle - centre - chain.joint_zero[limb, joint]
    base = parts[""]
    body = mass - float(masses.sum())
    moment = base.mass * (base.middle - centre)
    place = moment / body if body > 0 else np.zeros(3)
    return LinkMasses(masses, middle, inertia, body, place, base.inertia)


@dataclass(frozen=True)
class _Part:
    """Everything that moves as one; base frame turned to x right, y forward, z up."""

    mass: float
    middle: Array  # (3,) [m]
    inertia: Array  # (3, 3) about it


def _parts(found: UrdfModel) -> dict[str, _Part]:
    """By the joint of a leg that carries it, "" for the body, all angles zero or held."""
    pin, model = found.library, found.model
    data = model.createData()
    pin.forwardKinematics(model, data, found.angles({}))
    moved = {joint.name for leg in found.robot.joints.values() for joint in leg}
    sums: dict[str, _Part] = {}
    for index in range(1, model.njoints):
        here = index
        while here > 1 and model.names[here] not in moved:
            here = int(model.parents[here])
        name = str(model.names[here]) if here > 1 else ""
        own = data.oMi[index].act(model.inertias[index])
        part = _Part(
            float(own.mass),
            found.placed(np.array(own.lever)),
            found.turn @ np.array(own.inertia) @ found.turn.T,
        )
        sums[name] = _joined(sums[name], part) if name in sums else part
    return sums


def _joined(one: _Part, other: _Part) -> _Part:
    mass = one.mass + other.mass
    if mass <= 0:
        return one
    middle = (one.mass * one.middle + other.mass * other.middle) / mass
    inertia = one.inertia + other.inertia
    for part in (one, other):
        off = part.middle - middle
        inertia = inertia + part.mass * (off @ off * np.eye(3) - np.outer(off, off))
    return _Part(mass, middle, inertia)
