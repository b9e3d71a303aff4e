"""Limbs that end nearer to the body, where motors farther out cannot bear what a toe asks of them.

Wrists of humanoids are made for tools. Where a fair share of the weight, at the toe's lever, asks
for several times what a limb's last motors have, its toe is where the first of them begins: at the
end of the forearm, or at the elbow. What is beyond is held, turned back as far as it can be.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from climbplan.robots.urdf.building import chain_at_zero
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.limbs import FoundLimb
from climbplan.robots.urdf.proposal.toes import Toe, toe_at
from climbplan.robots.urdf.shapes import Shape
from climbplan.schema.robots.urdf.checks import FEWEST_JOINTS
from climbplan.schema.robots.urdf.tree import UrdfJoint

_WEAK = 0.25  # of what a fair share of the weight asks at the farthest lever
_STILL = 0.01  # [m] that a toe is from a joint, below which its link cannot stand on it
_DRAWN = 200  # postures in which levers are measured
_INSIDE = 1e-3  # [rad] of bounds
_TURN = 2.0  # [rad] that joints turn at most in these, and that what is held is turned back


@dataclass(frozen=True)
class Nearer:
    """A limb that ends before its weak motors."""

    limb: FoundLimb
    toe: Toe
    held: dict[str, float]  # angles of joints beyond [deg]


def nearer_end(
    found: UrdfModel, limb: FoundLimb, leg: LegAtZero, share: float, shapes: list[Shape]
) -> Nearer | None:
    """The limb without its weak end; None where its motors bear a fair share of the weight.

    None, too, where no end of it would: then what is missing is told of the whole limb.

    found: with all joints of the limb; leg: with its toe; share: of the weight that a limb bears
    [N]; shapes: collision geometry of the robot.
    """
    keep, words = len(leg.names), ""
    while True:
        here = _cut(leg, keep)
        joint = limb.joints[keep - 1]
        asked, has = share * _lever(here, limb), float(joint.effort or 0.0)
        can_end = float(np.linalg.norm(here.toe - here.joints[-1])) > _STILL
        if can_end and (has <= 0 or has >= _WEAK * asked):
            break
        if keep == FEWEST_JOINTS:
            return None
        if can_end:
            words = (
                f"{joint.name} has {has:g} N m where a fair share of the weight asks {asked:.2g}"
            )
        keep -= 1
    if keep == len(leg.names) or not words:
        return None
    kept, beyond = limb.joints[:keep], limb.joints[keep:]
    return Nearer(
        FoundLimb(kept, (*beyond, *limb.locked)),
        replace(
            toe_at(
                found, kept[-1].child, leg.joints[keep], f"where {beyond[0].name} begins: {words}"
            ),
            is_cut=True,
        ),
        _turned_back(leg, keep, limb, shapes),
    )


def _cut(leg: LegAtZero, keep: int) -> LegAtZero:
    """The leg with as many joints, its toe where the next one is."""
    if keep == len(leg.names):
        return leg
    return replace(
        leg,
        names=leg.names[:keep],
        joints=leg.joints[:keep],
        axes=leg.axes[:keep],
        toe=leg.joints[keep],
        slides=leg.slides[:keep],
        leaders=leg.leaders[:keep],
        ratios=leg.ratios[:keep],
    )


def _lever(leg: LegAtZero, limb: FoundLimb) -> float:
    """The farthest that the toe is from the axis of the last joint [m]."""
    joints = limb.joints[: len(leg.names)]
    low = np.array([max(j.lower, -_TURN) for j in joints])
    high = np.array([min(j.upper, _TURN) for j in joints])
    share = np.random.default_rng(0).random((_DRAWN, 1, len(joints)))
    chain = chain_at_zero([leg], len(joints), np.zeros(3), np.zeros((1, len(joints))))
    jacobian = chain.jacobian(low + share * (high - low))  # (D, 1, 3, J)
    return float(np.linalg.norm(jacobian[..., -1], axis=-1).max())


def _turned_back(
    leg: LegAtZero, keep: int, limb: FoundLimb, shapes: list[Shape]
) -> dict[str, float]:
    """Angles [deg] of joints beyond, in which what they carry is least far ahead of the toe."""
    beyond, toe = limb.joints[keep:], leg.joints[keep]
    away = [toe - joint for joint in leg.joints[keep - 1 :: -1]]
    along = next(way for way in away if np.linalg.norm(way) > _STILL)
    along = along / float(np.linalg.norm(along))
    names = [joint.name for joint in beyond]
    count = len(names)
    held = replace(
        leg,
        names=tuple(names),
        joints=leg.joints[keep:],
        axes=leg.axes[keep:],
        slides=leg.slides[keep:],
        leaders=tuple(range(count)),
        ratios=(1.0,) * count,
    )
    chain = chain_at_zero([held], count, np.zeros(3), np.zeros((1, count)))
    carried = [(names.index(shape.joint), shape) for shape in shapes if shape.joint in names]

    def ahead(angles: tuple[float, ...]) -> tuple[float, float]:
        pose = chain.pose(np.array([angles]))
        reach = [float((pose.toe[0] - toe) @ along)]
        for joint, shape in carried:
            from_joint = (shape.points - leg.joints[keep + joint]) @ pose.turns[0, joint].T
            points = from_joint + pose.places[0, joint] - toe
            reach.append(float((points @ along).max()) + shape.radius)
        return max(reach), float(np.abs(angles).sum())

    best = min(itertools.product(*map(_ways, beyond)), key=ahead)
    return {
        name: round(float(np.rad2deg(angle)), 2) for name, angle in zip(names, best, strict=True)
    }


def _ways(joint: UrdfJoint) -> list[float]:
    """Angles [rad] that a joint is tried at: as the URDF has it, and turned one way and the other.

    A little inside its bounds, so that no rounding is beyond them.
    """
    low, high = max(joint.lower, -_TURN) + _INSIDE, min(joint.upper, _TURN) - _INSIDE
    return sorted({low, min(max(0.0, low), high), high})
