"""Limbs keep off one another and off the body, as capsules beside capsules and the body's box.

Left out are the body and the first link of each limb, which a joint connects, links of one limb,
which joint bounds keep apart, the joint of the second link with the first, pairs that touch however
the robot stands (`Robot.touching`), and of robots from URDFs hips beside one another and beside the
body, first links and those between further joints in the same place: the capsules about their
housings are wider than these by centimetres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.clearance import told_room
from climbplan.climb.check.convex import ConvexBody
from climbplan.climb.check.distances import chain_distance, nearest_on
from climbplan.climb.check.subject import Subject
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.verification.check import Check, judge_worst

_TOLD = 0.02  # [m] room between parts up to which it is measured, not bounded
_OF_JOINT = 0.2  # of a radius: what of a link counts as the joint that carries it
_SAME_PLACE = 0.01  # [m] within which joints of a hip are
_NO_DIRECTION = 1e-12  # [m] a difference shorter than this has no direction


def self_collision_check(subject: Subject) -> Check:
    """At the instants."""
    pose = subject.plan.instants.com, subject.axes
    name = "limbs.self_collision"
    return judge_self_collision(name, subject, subject.capsules, *pose, subject.at)


def judge_self_collision(
    name: str,
    subject: Subject,
    capsules: Sequence[Capsule],
    com: Array,
    axes: Array,
    moment: Callable[[int], str],
) -> Check:
    """A check that links, as thick as they are, miss other limbs and the body.

    com: (P, 3), axes: (P, 3, 3) body axes as rows, at the poses of the capsules; `moment` describes
    a pose.
    """
    found = parts_apart(subject.plan.robot, subject.body_parts, capsules, com, axes)
    if not found.pairs:
        return judge_worst(name, np.zeros(1), lambda _: "", margin="no parts that could touch")

    def where(p: int, pair: int) -> str:
        one, other = found.pairs[pair]
        with_what = "the body" if other is None else subject.limb(other.limb, other.link)
        return f"{moment(p)}, {subject.limb(one.limb, one.link)} and {with_what}"

    used = found.radius / np.maximum(found.room + found.radius, 1e-9)
    return judge_worst(name, -found.room, where, told_room(found.room, found.radius), used)


@dataclass(frozen=True)
class PartsApart:
    """Room between the parts of a robot in P poses."""

    room: Array  # (P, Q) [m], below zero where they touch
    radius: Array  # (Q,) [m] of the thicker link
    pairs: tuple[tuple[Capsule, Capsule | None], ...]  # (Q,) None: the body


def parts_apart(
    robot: Robot,
    body_parts: Sequence[ConvexBody],
    capsules: Sequence[Capsule],
    com: Array,
    axes: Array,
) -> PartsApart:
    """Room between links and body parts, and links of two limbs; arguments as above."""
    left_out = {tuple(int(i) for i in row) for row in robot.touching}
    first = robot.has_joint.argmax(axis=1)
    hip = [_hip(robot, limb, int(first[limb])) for limb in range(robot.limb_count)]
    clear: list[Array] = []
    radii: list[float] = []
    pairs: list[tuple[Capsule, Capsule | None]] = []
    for one in capsules:
        joined = {int(first[one.limb])} if robot.capsules is None else hip[one.limb]
        if one.link in joined or (one.limb, one.number, -1, 0) in left_out:
            continue
        axis, radius = one.axis, one.radius
        if robot.capsules is None and one.link == first[one.limb] + 1:
            axis, radius = _past_joint(one)
        seen = np.einsum("pij,pej->pei", axes, axis - com[:, None])
        enough = radius + _TOLD
        distance = np.min([chain_distance(seen, b, enough)[:, 0] for b in body_parts], axis=0)
        clear.append(distance - radius)
        radii.append(one.radius)
        pairs.append((one, None))
    for one, other in itertools.combinations(capsules, 2):
        pair = (one.limb, one.number, other.limb, other.number)
        if one.limb == other.limb or pair in left_out:
            continue
        hips = one.link in hip[one.limb] and other.link in hip[other.limb]
        if hips and robot.capsules is not None:
            continue
        thick = one.radius + other.radius
        clear.append(segments_apart(one.axis, other.axis, thick + _TOLD) - thick)
        radii.append(max(one.radius, other.radius))
        pairs.append((one, other))
    room = np.stack(clear, axis=1) if clear else np.zeros((len(com), 0))
    return PartsApart(room, np.array(radii), tuple(pairs))


def _hip(robot: Robot, limb: int, first: int) -> set[int]:
    """Links of a limb that end where it begins, and its first link."""
    links = {first}
    if isinstance(robot.mechanism, SerialChain):
        places = robot.mechanism.joint_zero[limb]
        for link in range(first, len(places) - 1):
            if math.dist(places[link + 1], places[first]) >= _SAME_PLACE:
                break
            links.add(link)
    return links


def _past_joint(capsule: Capsule) -> tuple[Array, float]:
    """Axis (P, 2, 3) and radius of a straight link without the joint that carries it.

    The ball about that joint is part of the link before as well, which is left out. Of a capsule of
    radius r what is not within sqrt(r^2 + c^2 / 4) of the joint is within as much of its axis from
    c on.
    """
    along = capsule.ends - capsule.starts
    cut = _OF_JOINT * capsule.radius
    share = np.minimum(cut / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9), 1.0)
    axis = np.stack([capsule.starts + share * along, capsule.ends], axis=1)
    return axis, float(np.hypot(capsule.radius, cut / 2))


def _norm(vectors: Array) -> Array:
    """Lengths (...) of vectors (..., 3)."""
    return np.sqrt(np.einsum("...k,...k->...", vectors, vectors))


def segments_apart(one: Array, other: Array, enough: float) -> Array:
    """Distances (P,) of segments (P, 2, 3), or lower bounds that are at least `enough`; NaN stays.

    Where they are apart, the shortest way between them is along the normal of both, or from an end
    to its nearest place on the other. A plane leaves no more room than there is, whatever its
    direction, so no value is too large.
    """
    middle = (one[:, 0] + one[:, 1] - other[:, 0] - other[:, 1]) / 2
    half = (_norm(s[:, 1] - s[:, 0]) / 2 for s in (one, other))
    out = np.asarray(_norm(middle) - sum(half))
    near = ~(out >= enough)
    if not near.any():
        return out
    a, b = one[near], other[near]
    u, v = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    crossed = np.cross(u, v)
    ways = [crossed, -crossed]
    ways += [a[:, e] - nearest_on(a[:, e], b[:, 0], v) for e in (0, 1)]
    ways += [nearest_on(b[:, e], a[:, 0], u) - b[:, e] for e in (0, 1)]
    normals = np.stack(ways, axis=1)  # (S, 6, 3)
    length = _norm(normals)
    short = length < _NO_DIRECTION
    normals = normals / np.where(short, 1.0, length)[..., None]
    outer = np.minimum(*(np.einsum("sdk,sk->sd", normals, a[:, e]) for e in (0, 1)))
    inner = np.maximum(*(np.einsum("sdk,sk->sd", normals, b[:, e]) for e in (0, 1)))
    gap = np.where(short, -np.inf, outer - inner).max(axis=1)
    out[near] = np.where(np.isfinite(gap) | np.isnan(gap), gap, 0.0)  # crossing ones: zero
    return out
