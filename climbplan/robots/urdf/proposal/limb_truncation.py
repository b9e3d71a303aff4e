"""Truncation of limbs whose outer motors cannot bear the load on a toe.

Wrists of humanoids are made for tools. Where an equal share of the weight, at the toe's lever arm,
needs several times the torque of a limb's last motors, the toe moves to where the first of them
begins: the end of the forearm, or the elbow. The joints beyond are locked, folded back as far as
possible.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.limbs import LimbChain
from climbplan.robots.urdf.proposal.toes import Toe, build_toe
from climbplan.robots.urdf.robot_builder import build_chain_at_zero
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.schema.robots.urdf.checks import FEWEST_JOINTS
from climbplan.schema.robots.urdf.tree import UrdfJoint

_MIN_TORQUE_RATIO = 0.25  # torque limit over the load's moment at the longest lever arm
_MIN_TOE_DISTANCE = 0.01  # [m] of a toe from the last joint
_NUM_SAMPLES = 200  # postures in which lever arms are measured
_BOUND_MARGIN = 1e-3  # [rad] from joint bounds
_MAX_ANGLE = 2.0  # [rad] of joints in samples, and of folded joints


@dataclass(frozen=True)
class TruncatedLimb:
    """A limb that ends before its weak motors."""

    limb: LimbChain
    toe: Toe
    locked_angles: dict[str, float]  # of the joints beyond [deg]


def truncate_weak_limb(
    urdf_model: UrdfModel,
    limb: LimbChain,
    leg: LegAtZero,
    load: float,
    shapes: list[CollisionShape],
) -> TruncatedLimb | None:
    """Return the limb without its weak end; None if its motors bear the load.

    None, too, where no end of it would bear the load: error messages then describe the whole limb.

    Args:
        urdf_model: The robot, with all joints of the limb.
        limb: The limb.
        leg: Its geometry at zero angles, with its toe.
        load: Weight that a limb bears [N].
        shapes: Collision geometry of the robot.
    """
    count, reason = len(leg.names), ""
    while True:
        cut = _cut_leg(leg, count)
        joint = limb.joints[count - 1]
        required, limit = load * _measure_lever_arm(cut, limb), float(joint.effort or 0.0)
        can_end = float(np.linalg.norm(cut.toe - cut.joints[-1])) > _MIN_TOE_DISTANCE
        if can_end and (limit <= 0 or limit >= _MIN_TORQUE_RATIO * required):
            break
        if count == FEWEST_JOINTS:
            return None
        if can_end:
            reason = (
                f"{joint.name} has {limit:g} N m where a fair share of the weight asks "
                f"{required:.2g}"
            )
        count -= 1
    if count == len(leg.names) or not reason:
        return None
    remaining, beyond = limb.joints[:count], limb.joints[count:]
    return TruncatedLimb(
        LimbChain(remaining, (*beyond, *limb.locked)),
        replace(
            build_toe(
                urdf_model,
                remaining[-1].child,
                leg.joints[count],
                f"where {beyond[0].name} begins: {reason}",
            ),
            is_truncated=True,
        ),
        _fold_back(leg, count, limb, shapes),
    )


def _cut_leg(leg: LegAtZero, count: int) -> LegAtZero:
    """Return the leg with its first `count` joints, its toe where the next one is."""
    if count == len(leg.names):
        return leg
    return replace(
        leg,
        names=leg.names[:count],
        joints=leg.joints[:count],
        axes=leg.axes[:count],
        toe=leg.joints[count],
        slides=leg.slides[:count],
        leaders=leg.leaders[:count],
        ratios=leg.ratios[:count],
    )


def _measure_lever_arm(leg: LegAtZero, limb: LimbChain) -> float:
    """Return the longest sampled lever arm of the toe about the axis of the last joint [m]."""
    joints = limb.joints[: len(leg.names)]
    low = np.array([max(j.lower, -_MAX_ANGLE) for j in joints])
    high = np.array([min(j.upper, _MAX_ANGLE) for j in joints])
    fraction = np.random.default_rng(0).random((_NUM_SAMPLES, 1, len(joints)))
    chain = build_chain_at_zero([leg], len(joints), np.zeros(3), np.zeros((1, len(joints))))
    jacobian = chain.jacobian(low + fraction * (high - low))  # (D, 1, 3, J)
    return float(np.linalg.norm(jacobian[..., -1], axis=-1).max())


def _fold_back(
    leg: LegAtZero, count: int, limb: LimbChain, shapes: list[CollisionShape]
) -> dict[str, float]:
    """Return angles [deg] of the joints beyond in which their links protrude least past the toe."""
    beyond, toe = limb.joints[count:], leg.joints[count]
    directions = [toe - joint for joint in leg.joints[count - 1 :: -1]]
    axis = next(
        direction for direction in directions if np.linalg.norm(direction) > _MIN_TOE_DISTANCE
    )
    axis = axis / float(np.linalg.norm(axis))
    names = [joint.name for joint in beyond]
    num_folded = len(names)
    folded = replace(
        leg,
        names=tuple(names),
        joints=leg.joints[count:],
        axes=leg.axes[count:],
        slides=leg.slides[count:],
        leaders=tuple(range(num_folded)),
        ratios=(1.0,) * num_folded,
    )
    chain = build_chain_at_zero([folded], num_folded, np.zeros(3), np.zeros((1, num_folded)))
    carried = [(names.index(shape.joint), shape) for shape in shapes if shape.joint in names]

    def compute_protrusion(angles: tuple[float, ...]) -> tuple[float, float]:
        pose = chain.pose(np.array([angles]))
        reach = [float((pose.toe[0] - toe) @ axis)]
        for joint, shape in carried:
            from_joint = (shape.points - leg.joints[count + joint]) @ pose.turns[0, joint].T
            points = from_joint + pose.places[0, joint] - toe
            reach.append(float((points @ axis).max()) + shape.radius)
        return max(reach), float(np.abs(angles).sum())

    best = min(itertools.product(*map(_list_fold_angles, beyond)), key=compute_protrusion)
    return {
        name: round(float(np.rad2deg(angle)), 2) for name, angle in zip(names, best, strict=True)
    }


def _list_fold_angles(joint: UrdfJoint) -> list[float]:
    """Return the angles [rad] that are tried for a joint: zero, and both bounds.

    They lie a little inside the bounds, so that rounding does not violate them.
    """
    low, high = (
        max(joint.lower, -_MAX_ANGLE) + _BOUND_MARGIN,
        min(joint.upper, _MAX_ANGLE) - _BOUND_MARGIN,
    )
    return sorted({low, min(max(0.0, low), high), high})
