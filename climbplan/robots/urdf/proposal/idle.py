"""Where joints are held that move no leg: an arm on the back of a quadruped, a head.

They stay at zero, as the URDF has them, unless what they carry is in the way of body or legs there.
Then the posture is drawn at random that touches least, and of these the one that reaches least far
aside from the middle of the legs, with its weight near to that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.urdf.proposal.touching import Parts, parts_of
from climbplan.spec.robots.urdf.tree import UrdfTree

Bounds = dict[str, tuple[float, float]]  # of joints by name [rad]
_DRAWN = 160  # postures of the joints
_LEGS = 8  # postures of legs that each is held against
_IN_THE_WAY = 0.5  # pairs that touch at zero, in the mean over postures of legs, let pass


def idle_joints(tree: UrdfTree, legs: set[str], locked: set[str]) -> Bounds:
    """Joints that turn and that neither legs nor `locked` have; those that mimic others are left.

    Bounds [rad]; one turn where there are none.
    """
    out: Bounds = {}
    for joint in tree.joints.values():
        if not joint.turns or joint.mimics is not None or joint.name in legs | locked:
            continue
        low, high = max(joint.lower, -np.pi), min(joint.upper, np.pi)
        if low < high:
            out[joint.name] = (float(low), float(high))
    return out


def rest_of(found: UrdfModel, idle: Bounds, legs: Bounds, hips: Array) -> dict[str, float]:
    """Angles [deg] of idle joints that are in the way at zero; empty where they are not.

    found: with collision geometry; legs: bounds of their joints; hips: (N, 3) first joints [m].
    """
    if not idle:
        return {}
    parts = parts_of(found, idle | legs)
    carried = _carried(found, parts, idle)
    if not carried:
        return {}
    rng = np.random.default_rng(0)
    stands = [_drawn(legs, rng) for _ in range(_LEGS)]
    zero = {name: float(np.clip(0.0, *bound)) for name, bound in idle.items()}
    if _met(parts, carried, zero, stands) <= _IN_THE_WAY:
        return {}
    tried = [zero] + [_drawn(idle, rng) for _ in range(_DRAWN)]
    alone = [own for own in tried if not _met(parts, carried, own, stands[:1])]
    middle = hips.mean(axis=0)[:2]

    def worth(own: dict[str, float]) -> tuple[float, float]:
        aside = np.abs(_joints(found, idle, own) - middle).max()
        off = np.linalg.norm(found.center(own)[:2] - middle)
        return _met(parts, carried, own, stands), float(aside + off)

    best = min(alone or tried, key=worth)
    return {name: round(float(np.rad2deg(angle)), 1) for name, angle in best.items()}


def _drawn(bounds: Bounds, rng: np.random.Generator) -> dict[str, float]:
    return {name: float(rng.uniform(low, high)) for name, (low, high) in bounds.items()}


def _met(
    parts: Parts, carried: set[str], own: dict[str, float], stands: list[dict[str, float]]
) -> float:
    """Pairs with a part that idle joints carry that touch, in the mean over postures of legs."""
    counts = [
        sum(bool(carried & set(pair)) for pair in parts.touching(own | stand)) for stand in stands
    ]
    return float(np.mean(counts))


def _joints(found: UrdfModel, idle: Bounds, own: dict[str, float]) -> Array:
    """(J, 2) where idle joints are, seen from above [m]."""
    data = found.model.createData()
    found.library.forwardKinematics(found.model, data, found.angles(own))
    at = [data.oMi[found.model.getJointId(name)].translation for name in idle]
    return np.asarray(found.placed(np.array(at))[:, :2])


def _carried(found: UrdfModel, parts: Parts, idle: Bounds) -> set[str]:
    """Names of the parts that idle joints move."""
    model: Any = found.model
    moved = set()
    for item in parts.geometry.geometryObjects:
        joint = int(item.parentJoint)
        while joint > 1 and model.names[joint] not in idle:
            joint = int(model.parents[joint])
        if joint > 1:
            moved.add(str(item.name))
    return moved
