"""Locking of joints that move no leg: an arm on the back of a quadruped, a head.

They stay at zero, as in the URDF, unless their links are in the way of body or legs there.
Otherwise a random search finds the posture that protrudes least on either side of the body, where
walls may be, has its weight near the middle of the legs, and has few collisions.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.urdf.proposal.self_collision import (
    SelfCollisionModel,
    build_self_collision_model,
)
from climbplan.schema.robots.urdf.tree import UrdfTree

JointBounds = dict[str, tuple[float, float]]  # by joint [rad]
_NUM_SAMPLES = 800  # postures of the joints
_NUM_LEG_POSTURES = 8  # with which each sample is combined
_COLLISION_COST = 0.05  # [m] of protrusion per colliding pair
_MAX_COLLISIONS = 0.5  # pairs that touch at zero, mean over leg postures


def find_unused_joints(tree: UrdfTree, legs: set[str], locked: set[str]) -> JointBounds:
    """Return bounds [rad] of joints that turn and are neither in legs nor locked, nor mimic others.

    Args:
        tree: The URDF.
        legs: Joints of legs.
        locked: Joints that are locked already.

    Returns:
        Bounds by joint [rad]; one turn where there are none.
    """
    bounds: JointBounds = {}
    for joint in tree.joints.values():
        if not joint.turns or joint.mimics is not None or joint.name in legs | locked:
            continue
        low, high = max(joint.lower, -np.pi), min(joint.upper, np.pi)
        if low < high:
            bounds[joint.name] = (float(low), float(high))
    return bounds


def choose_locked_angles(
    urdf_model: UrdfModel, unused: JointBounds, legs: JointBounds, hips: Array
) -> dict[str, float]:
    """Return angles [deg] of unused joints that are in the way at zero; empty where they are not.

    Args:
        urdf_model: The robot, with collision geometry.
        unused: Bounds of the unused joints [rad].
        legs: Bounds of the joints of legs [rad].
        hips: First joints of legs (N, 3) [m].
    """
    if not unused:
        return {}
    collision_model = build_self_collision_model(urdf_model, unused | legs)
    carried = _find_carried_parts(urdf_model, collision_model, unused)
    if not carried:
        return {}
    rng = np.random.default_rng(0)
    leg_postures = [_sample_angles(legs, rng) for _ in range(_NUM_LEG_POSTURES)]
    zero = {name: float(np.clip(0.0, *bound)) for name, bound in unused.items()}
    if _count_collisions(collision_model, carried, zero, leg_postures) <= _MAX_COLLISIONS:
        return {}
    outline = _LateralExtent(urdf_model, collision_model, carried)
    middle = hips.mean(axis=0)[:2]

    def compute_protrusion(angles: dict[str, float]) -> float:
        offset = np.linalg.norm(urdf_model.compute_center(angles)[:2] - middle)
        return outline.compute_protrusion(angles, float(middle[0])) + float(offset)

    samples = sorted(
        (_sample_angles(unused, rng) for _ in range(_NUM_SAMPLES)), key=compute_protrusion
    )

    def select_best(postures: list[dict[str, float]]) -> dict[str, float] | None:
        """Return the best sample without collisions in these postures of legs, if there is one."""
        selected, min_cost = None, np.inf
        for sample in samples:
            if (cost := compute_protrusion(sample)) >= min_cost:
                break
            if _count_collisions(collision_model, carried, sample, postures):
                continue
            cost += (
                _count_collisions(collision_model, carried, sample, leg_postures) * _COLLISION_COST
            )
            if cost < min_cost:
                selected, min_cost = sample, cost
        return selected

    angles = select_best(leg_postures[:1]) or select_best([]) or zero
    return {name: round(float(np.rad2deg(angle)), 1) for name, angle in angles.items()}


class _LateralExtent:
    """How far the links of unused joints protrude beside the body."""

    def __init__(
        self, urdf_model: UrdfModel, collision_model: SelfCollisionModel, carried: set[str]
    ) -> None:
        self.urdf_model, self.collision_model = urdf_model, collision_model
        self.data, self.shapes = (
            urdf_model.model.createData(),
            collision_model.geometry.createData(),
        )
        self.corners: list[tuple[int, Array]] = []
        body = []
        for number, item in enumerate(collision_model.geometry.geometryObjects):
            item.geometry.computeLocalAABB()
            box = item.geometry.aabb_local
            corners = np.array(list(itertools.product(*zip(box.min_, box.max_, strict=True))))
            if item.name in carried:
                self.corners.append((number, corners))
            elif int(item.parentJoint) == 1:
                body.append((number, corners))
        self.body = self._compute_lateral_positions(body, {})

    def compute_protrusion(self, angles: dict[str, float], middle: float) -> float:
        """Return by how much they are farther from the middle than the body, on either side [m]."""
        half = float(
            np.abs(self._compute_lateral_positions(self.corners, angles) - middle).max(initial=0.0)
        )
        return max(half - float(np.abs(self.body - middle).max(initial=0.0)), 0.0)

    def _compute_lateral_positions(
        self, corners: list[tuple[int, Array]], angles: dict[str, float]
    ) -> Array:
        """Return x coordinates [m] of the corners of parts' bounding boxes, left to right."""
        urdf_model, pin = self.urdf_model, self.urdf_model.library
        pin.updateGeometryPlacements(
            urdf_model.model,
            self.data,
            self.collision_model.geometry,
            self.shapes,
            urdf_model.build_configuration(angles),
        )
        placements = [self.shapes.oMg[number] for number, _ in corners]
        points = [
            corner_points @ place.rotation.T + place.translation
            for (_, corner_points), place in zip(corners, placements, strict=True)
        ]
        return urdf_model.to_base_axes(np.concatenate(points))[:, 0] if points else np.zeros(0)


def _sample_angles(bounds: JointBounds, rng: np.random.Generator) -> dict[str, float]:
    """Return uniform random angles within bounds, by joint [rad]."""
    return {name: float(rng.uniform(low, high)) for name, (low, high) in bounds.items()}


def _count_collisions(
    collision_model: SelfCollisionModel,
    carried: set[str],
    angles: dict[str, float],
    leg_postures: list[dict[str, float]],
) -> float:
    """Return the number of colliding pairs with a carried part, mean over postures of legs."""
    counts = [
        sum(bool(carried & set(pair)) for pair in collision_model.find_collisions(angles | posture))
        for posture in leg_postures
    ]
    return float(np.mean(counts)) if counts else 0.0


def _find_carried_parts(
    urdf_model: UrdfModel, collision_model: SelfCollisionModel, unused: JointBounds
) -> set[str]:
    """Return names of the parts that unused joints move."""
    model: Any = urdf_model.model
    carried = set()
    for item in collision_model.geometry.geometryObjects:
        joint = int(item.parentJoint)
        while joint > 1 and model.names[joint] not in unused:
            joint = int(model.parents[joint])
        if joint > 1:
            carried.add(str(item.name))
    return carried
