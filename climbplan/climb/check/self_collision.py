"""Checks that limbs miss one another and the body, as capsules and the body's box.

Excluded are pairs that are always close:

- the body and the first link of each limb, which a joint connects;
- links of one limb, which joint bounds separate;
- the joint between first and second link;
- pairs that touch in every posture (`Robot.touching`);
- for robots from URDFs, hips and neighbouring hips or the body, since capsules about their housings
  are wider than these by centimetres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.clearance import describe_clearance
from climbplan.climb.check.convex import ConvexBody
from climbplan.climb.check.distances import find_nearest_on_segment, measure_motion_distance
from climbplan.climb.check.subject import Subject
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.verification.check import Check, judge_worst

_REPORTED_CLEARANCE = 0.02  # [m] room between parts up to which it is measured, not bounded
_JOINT_FRACTION = 0.2  # of a radius: what of a link counts as the joint that carries it
_HIP_TOLERANCE = 0.01  # [m] within which joints of a hip are
_MIN_LENGTH = 1e-12  # [m] a difference shorter than this has no direction


def check_self_collision(subject: Subject) -> Check:
    """Check self-collision at the instants."""
    pose = subject.plan.instants.com, subject.axes
    name = "limbs.self_collision"
    return judge_self_collision(name, subject, subject.capsules, *pose, subject.describe_instant)


def judge_self_collision(
    name: str,
    subject: Subject,
    capsules: Sequence[Capsule],
    com: Array,
    axes: Array,
    describe_pose: Callable[[int], str],
) -> Check:
    """Check that links with their thickness miss other limbs and the body.

    Args:
        name: Name of the check.
        subject: The plan under verification.
        capsules: Capsules of all limbs in P poses.
        com: (P, 3) body origins [m].
        axes: (P, 3, 3) body axes as rows.
        describe_pose: Describes a pose.
    """
    clearances = measure_part_clearances(
        subject.plan.robot, subject.body_parts, capsules, com, axes
    )
    if not clearances.pairs:
        return judge_worst(name, np.zeros(1), lambda _: "", margin="no parts that could touch")

    def describe_place(p: int, pair: int) -> str:
        first, second = clearances.pairs[pair]
        second_name = "the body" if second is None else subject.name_limb(second.limb, second.link)
        return f"{describe_pose(p)}, {subject.name_limb(first.limb, first.link)} and {second_name}"

    load_ratio = clearances.radius / np.maximum(clearances.clearance + clearances.radius, 1e-9)
    return judge_worst(
        name,
        -clearances.clearance,
        describe_place,
        describe_clearance(clearances.clearance, clearances.radius),
        load_ratio,
    )


@dataclass(frozen=True)
class PartClearances:
    """Clearances between the parts of a robot in P poses."""

    clearance: Array  # (P, Q) [m], below zero where they touch; but for the least a lower bound
    radius: Array  # (Q,) [m] of the thicker link
    pairs: tuple[tuple[Capsule, Capsule | None], ...]  # (Q,) None: the body


def measure_part_clearances(
    robot: Robot,
    body_parts: Sequence[ConvexBody],
    capsules: Sequence[Capsule],
    com: Array,
    axes: Array,
) -> PartClearances:
    """Return the clearances between links and body parts, and between links of different limbs.

    Args:
        robot: The robot.
        body_parts: Convex parts of the body, in its frame.
        capsules: Capsules of all limbs in P poses.
        com: (P, 3) body origins [m].
        axes: (P, 3, 3) body axes as rows.
    """
    measured = [
        *_measure_body_clearances(robot, body_parts, capsules, com, axes),
        *_measure_limb_clearances(robot, capsules),
    ]
    if not measured:
        return PartClearances(np.zeros((len(com), 0)), np.zeros(0), ())
    clearances, radii, pairs = zip(*measured, strict=True)
    return PartClearances(np.stack(clearances, axis=1), np.array(radii), pairs)


# Clearance (P,), radius of the thicker link and the pair, where None stands for the body
_PairClearance = tuple[Array, float, tuple[Capsule, Capsule | None]]


def _measure_body_clearances(
    robot: Robot,
    body_parts: Sequence[ConvexBody],
    capsules: Sequence[Capsule],
    com: Array,
    axes: Array,
) -> Iterator[_PairClearance]:
    """Yield the clearances between links and body parts; arguments as `measure_part_clearances`."""
    excluded_pairs = _list_touching_pairs(robot)
    first_links = robot.has_joint.argmax(axis=1)
    hip = _list_hip_links(robot)
    for first_capsule in capsules:
        joined_links = (
            {int(first_links[first_capsule.limb])}
            if robot.capsules is None
            else hip[first_capsule.limb]
        )
        if (
            first_capsule.link in joined_links
            or (first_capsule.limb, first_capsule.number, -1, 0) in excluded_pairs
        ):
            continue
        axis, radius = first_capsule.axis, first_capsule.radius
        if robot.capsules is None and first_capsule.link == first_links[first_capsule.limb] + 1:
            axis, radius = _shorten_past_joint(first_capsule)
        axis_in_body = np.einsum("pij,pej->pei", axes, axis - com[:, None])
        sufficient = radius + _REPORTED_CLEARANCE
        distance = np.min(
            [measure_motion_distance(axis_in_body, b, sufficient) for b in body_parts], axis=0
        )
        yield distance - radius, first_capsule.radius, (first_capsule, None)


def _measure_limb_clearances(robot: Robot, capsules: Sequence[Capsule]) -> Iterator[_PairClearance]:
    """Yield the clearances between links of different limbs."""
    excluded_pairs, hip = _list_touching_pairs(robot), _list_hip_links(robot)
    for first_capsule, second_capsule in itertools.combinations(capsules, 2):
        pair = (
            first_capsule.limb,
            first_capsule.number,
            second_capsule.limb,
            second_capsule.number,
        )
        if first_capsule.limb == second_capsule.limb or pair in excluded_pairs:
            continue
        are_hips = (
            first_capsule.link in hip[first_capsule.limb]
            and second_capsule.link in hip[second_capsule.limb]
        )
        if are_hips and robot.capsules is not None:
            continue
        total_radius = first_capsule.radius + second_capsule.radius
        distance = measure_segment_distances(
            first_capsule.axis, second_capsule.axis, total_radius + _REPORTED_CLEARANCE
        )
        radius = max(first_capsule.radius, second_capsule.radius)
        yield distance - total_radius, radius, (first_capsule, second_capsule)


def _list_touching_pairs(robot: Robot) -> set[tuple[int, ...]]:
    """Return limb and number of both parts of each pair that touches in every posture."""
    return {tuple(int(i) for i in row) for row in robot.touching}


def _list_hip_links(robot: Robot) -> list[set[int]]:
    """Return the links of each limb that are part of its hip."""
    first_links = robot.has_joint.argmax(axis=1)
    return [_find_hip_links(robot, limb, int(link)) for limb, link in enumerate(first_links)]


def _find_hip_links(robot: Robot, limb: int, first: int) -> set[int]:
    """Return the first link of a limb and those that end where it begins."""
    links = {first}
    if isinstance(robot.mechanism, SerialChain):
        places = robot.mechanism.joint_zero[limb]
        for link in range(first, len(places) - 1):
            if math.dist(places[link + 1], places[first]) >= _HIP_TOLERANCE:
                break
            links.add(link)
    return links


def _shorten_past_joint(capsule: Capsule) -> tuple[Array, float]:
    """Return axis (P, 2, 3) and radius of a straight link without the joint that carries it.

    The ball about that joint is part of the previous link as well, which is excluded. Points of a
    capsule of radius r outside the ball of radius sqrt(r^2 + c^2 / 4) about the joint are within
    that distance of the axis from c on.
    """
    link_vector = capsule.ends - capsule.starts
    cut = _JOINT_FRACTION * capsule.radius
    fraction = np.minimum(
        cut / np.maximum(np.linalg.norm(link_vector, axis=-1, keepdims=True), 1e-9), 1.0
    )
    axis = np.stack([capsule.starts + fraction * link_vector, capsule.ends], axis=1)
    return axis, float(np.hypot(capsule.radius, cut / 2))


def _compute_norms(vectors: Array) -> Array:
    """Return lengths (...) of vectors (..., 3)."""
    return np.sqrt(np.einsum("...k,...k->...", vectors, vectors))


def measure_segment_distances(
    first_segment: Array, second_segment: Array, sufficient: float
) -> Array:
    """Return distances (P,) of segments (P, 2, 3), or lower bounds of at least `sufficient`; NaN
    stays.

    Where they are disjoint, the shortest line between them is along the normal of both, or from an
    end to its nearest point on the other. The gap of any plane is a lower bound on the distance.
    """
    middle = (
        first_segment[:, 0] + first_segment[:, 1] - second_segment[:, 0] - second_segment[:, 1]
    ) / 2
    half = (_compute_norms(s[:, 1] - s[:, 0]) / 2 for s in (first_segment, second_segment))
    distance = np.asarray(_compute_norms(middle) - sum(half))
    is_near = ~(distance >= sufficient)
    if not is_near.any():
        return distance
    a, b = first_segment[is_near], second_segment[is_near]
    u, v = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    cross_direction = np.cross(u, v)
    directions = [cross_direction, -cross_direction]
    directions += [a[:, e] - find_nearest_on_segment(a[:, e], b[:, 0], v) for e in (0, 1)]
    directions += [find_nearest_on_segment(b[:, e], a[:, 0], u) - b[:, e] for e in (0, 1)]
    normals = np.stack(directions, axis=1)  # (S, 6, 3)
    length = _compute_norms(normals)
    is_degenerate = length < _MIN_LENGTH
    normals = normals / np.where(is_degenerate, 1.0, length)[..., None]
    outer = np.minimum(*(np.einsum("sdk,sk->sd", normals, a[:, e]) for e in (0, 1)))
    inner = np.maximum(*(np.einsum("sdk,sk->sd", normals, b[:, e]) for e in (0, 1)))
    gap = np.where(is_degenerate, -np.inf, outer - inner).max(axis=1)
    distance[is_near] = np.where(np.isfinite(gap) | np.isnan(gap), gap, 0.0)  # crossing ones: zero
    return distance
