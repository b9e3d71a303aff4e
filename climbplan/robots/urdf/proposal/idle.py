"""Where joints are held that move no leg: an arm on the back of a quadruped, a head.

They stay at zero, as the URDF has them, unless what they carry is in the way of body or legs there.
Then the posture is drawn at random that stands out least on either side of the body, where walls
may be, with its weight near to the middle of the legs, and that touches little.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.urdf.proposal.touching import Parts, parts_of
from climbplan.schema.robots.urdf.tree import UrdfTree

Bounds = dict[str, tuple[float, float]]  # of joints by name [rad]
_DRAWN = 800  # postures of the joints
_LEGS = 8  # postures of legs that each is held against
_TOUCHING = 0.05  # [m] of standing out that a pair is worth
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
    outline = _Outline(found, parts, carried)
    middle = hips.mean(axis=0)[:2]

    def out(own: dict[str, float]) -> float:
        off = np.linalg.norm(found.center(own)[:2] - middle)
        return outline.beyond(own, float(middle[0])) + float(off)

    tried = sorted((_drawn(idle, rng) for _ in range(_DRAWN)), key=out)

    def best(stand: list[dict[str, float]]) -> dict[str, float] | None:
        """The best of those that touch nothing in a posture of legs."""
        found, least = None, np.inf
        for own in tried:
            if (worth := out(own)) >= least:
                break
            if _met(parts, carried, own, stand):
                continue
            worth += _met(parts, carried, own, stands) * _TOUCHING
            if worth < least:
                found, least = own, worth
        return found

    held = best(stands[:1]) or best([]) or zero
    return {name: round(float(np.rad2deg(angle)), 1) for name, angle in held.items()}


class _Outline:
    """How far what idle joints carry stands out beside the body."""

    def __init__(self, found: UrdfModel, parts: Parts, carried: set[str]) -> None:
        self.found, self.parts = found, parts
        self.data, self.shapes = found.model.createData(), parts.geometry.createData()
        self.corners: list[tuple[int, Array]] = []
        body = []
        for number, item in enumerate(parts.geometry.geometryObjects):
            item.geometry.computeLocalAABB()
            box = item.geometry.aabb_local
            corners = np.array(list(itertools.product(*zip(box.min_, box.max_, strict=True))))
            if item.name in carried:
                self.corners.append((number, corners))
            elif int(item.parentJoint) == 1:
                body.append((number, corners))
        self.body = self._across(body, {})

    def beyond(self, own: dict[str, float], middle: float) -> float:
        """[m] by which it is farther from the middle than the body is, on either side."""
        half = float(np.abs(self._across(self.corners, own) - middle).max(initial=0.0))
        return max(half - float(np.abs(self.body - middle).max(initial=0.0)), 0.0)

    def _across(self, corners: list[tuple[int, Array]], own: dict[str, float]) -> Array:
        """Places from left to right [m] of the corners of boxes about parts."""
        found, pin = self.found, self.found.library
        pin.updateGeometryPlacements(
            found.model, self.data, self.parts.geometry, self.shapes, found.angles(own)
        )
        at = [self.shapes.oMg[number] for number, _ in corners]
        points = [
            c @ place.rotation.T + place.translation
            for (_, c), place in zip(corners, at, strict=True)
        ]
        return found.placed(np.concatenate(points))[:, 0] if points else np.zeros(0)


def _drawn(bounds: Bounds, rng: np.random.Generator) -> dict[str, float]:
    return {name: float(rng.uniform(low, high)) for name, (low, high) in bounds.items()}


def _met(
    parts: Parts, carried: set[str], own: dict[str, float], stands: list[dict[str, float]]
) -> float:
    """Pairs with a part that idle joints carry that touch, in the mean over postures of legs."""
    counts = [
        sum(bool(carried & set(pair)) for pair in parts.touching(own | stand)) for stand in stands
    ]
    return float(np.mean(counts)) if counts else 0.0


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
