"""What each link of a climbing robot weighs in a simulation, and where.

A plan counts the robot's whole mass to its body. Simulated links weigh what the URDF that the plan
carries says of them: mass, centre and inertia of everything that moves with a joint, held joints
and fixed links included. Those of other robots weigh a share of the whole, spread evenly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import UrdfModel, urdf_model
from climbplan.simulation.conditions import Conditions
from climbplan.spec.robots.stored import NotKept, stored_robot
from climbplan.spec.robots.urdf.source import UrdfRobot
from climbplan.spec.yaml_source import parse_yaml

_LEAST = 1e-4  # [kg] of a body, for MuJoCo
_LEAST_INERTIA = 1e-7  # [kg m^2] about any axis


@dataclass(frozen=True)
class LinkMasses:
    """Links of chains, body frame, at zero angles; and what is left to the body."""

    mass: Array  # (N, J) [kg]
    middle: Array  # (N, J, 3) centre of mass from the link's joint [m]
    inertia: Array  # (N, J, 3, 3) about it [kg m^2]
    body_mass: float  # [kg]
    body_middle: Array  # (3,) from the body's origin [m]
    body_inertia: Array  # (3, 3) about it [kg m^2]


def link_masses(plan: ClimbPlan, conditions: Conditions) -> LinkMasses | None:
    """Of the robot from a URDF that a plan carries; None for others, and where a share is given.

    What the robot file says of the whole mass beside the URDF's is the body's. Raises
    MissingSolver without Pinocchio.
    """
    chain = plan.robot.mechanism
    if conditions.limb_mass_share is not None or not isinstance(chain, SerialChain):
        return None
    try:
        stored = stored_robot(parse_yaml(plan.spec_text, "spec"), plan.robot_texts).robot
    except NotKept:  # a plan without the text of its robot's file
        return None
    if not isinstance(stored, UrdfRobot):
        return None
    found = urdf_model(stored)
    parts = _parts(found)
    names = chain.names
    last = found.leg(stored.limb_names[0])
    centre = last.joints[-1] - chain.joint_zero[0, -1]  # the body's origin, from the base
    count = (len(names), len(names[0]))
    mass, middle = np.full(count, _LEAST), np.zeros((*count, 3))
    inertia = np.broadcast_to(_LEAST_INERTIA * np.eye(3), (*count, 3, 3)).copy()
    for limb, own in enumerate(names):
        for joint, name in enumerate(own):
            if not name:
                continue
            part = parts.pop(name)
            mass[limb, joint] = max(part.mass, _LEAST)
            middle[limb, joint] = part.middle - centre - chain.joint_zero[limb, joint]
            inertia[limb, joint] = _valid(part.inertia)
    base = parts[""]
    body = plan.robot.mass - float(mass.sum())
    return LinkMasses(mass, middle, inertia, body, base.middle - centre, _valid(base.inertia))


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


def _valid(inertia: Array) -> Array:
    """An inertia that a body can have: positive, and no moment above the sum of the others."""
    value, vector = np.linalg.eigh((inertia + inertia.T) / 2)
    value = np.maximum(value, _LEAST_INERTIA)
    value[0] = max(value[0], value[2] - value[1])
    return np.asarray(vector * value @ vector.T)
