"""Parts of a robot that touch however it stands, by the capsules and boxes that hold them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from climbplan.arrays import Array, IntArray
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

_DRAWN = 60  # postures that tell which parts always touch
_ALWAYS = 0.5  # share of these
_ONE_PLACE = 0.01  # [m] within which joints of a hip are in one place
_PLACES = 17  # looked at along an axis


def parts_beside(robot: Robot, links: Capsules) -> tuple[IntArray, IntArray]:
    """Pairs that have to keep apart: of limbs and the body (B, 4), of two limbs (Q, 4).

    A row is limb and capsule, and limb and capsule or -1 and 0 for the body. The first link of a
    limb is joined with the body; links of one limb are kept apart by joint bounds. Hips that are
    as thick as their parts have capsules that are wider, beside the body and beside one another:
    first links, and those further out while joints are in one place.
    """
    count, limbs = links.radius.shape[1], range(robot.limb_count)
    first, hip = robot.has_joint.argmax(axis=1), _hips(robot)
    left_out = {tuple(row) for row in robot.touching.tolist()}
    joined = first if robot.capsules is None else hip
    to_body = [(i, c, -1, 0) for i in limbs for c in range(count) if links.link[i, c] > joined[i]]
    between = [
        (i, c, other, beside)
        for i in limbs
        for other in range(i + 1, robot.limb_count)
        for c in range(count)
        for beside in range(count)
        if robot.capsules is None
        or links.link[i, c] > hip[i]
        or links.link[other, beside] > hip[other]
    ]

    def kept(pairs: list[tuple[int, int, int, int]]) -> IntArray:
        return np.array([p for p in pairs if p not in left_out], np.int64).reshape(-1, 4)

    return kept(to_body), kept(between)


def _hips(robot: Robot) -> IntArray:
    """(N,) the last link of each limb that is a part of its hip."""
    hip = robot.has_joint.argmax(axis=1)
    if isinstance(robot.mechanism, SerialChain):
        joints = robot.mechanism.joint_zero
        for limb, first in enumerate(hip.copy()):
            near = np.linalg.norm(joints[limb, first:] - joints[limb, first], axis=-1) < _ONE_PLACE
            hip[limb] = first + max(int(np.logical_and.accumulate(near).sum()) - 2, 0)
    return np.asarray(hip, np.int64)


def always_touching(robot: Robot, parts: Sequence[Array]) -> IntArray:
    """Pairs (T, 4) that touch in most postures within joint bounds; parts: (V, 3) of the body."""
    share = np.random.default_rng(0).random((_DRAWN, robot.limb_count, robot.joint_count))
    low, high = np.clip(robot.joint_lower, -np.pi, np.pi), np.clip(robot.joint_upper, -np.pi, np.pi)
    links = limb_capsules(robot, low + share * (high - low))
    body, limbs = parts_beside(robot, links)
    along = np.linspace(0.0, 1.0, _PLACES)[:, None]
    own = body[:, 0], body[:, 1]
    starts, ends = (v[..., own[0], own[1], None, :] for v in (links.starts, links.ends))
    places = starts + along * (ends - starts)  # (D, B, S, 3)
    near = np.full(places.shape[:2], np.inf)
    for part in parts:
        faces = ConvexHull(part).equations
        away = (places @ faces[:, :3].T + faces[:, 3]).max(axis=-1).min(axis=-1)
        near = np.minimum(near, away)
    apart = np.concatenate([near - links.radius[own], limbs_room(links, limbs)], axis=-1)
    touch = (apart < 0).mean(axis=0) > _ALWAYS
    return np.asarray(np.concatenate([body, limbs])[touch])


def limbs_room(links: Capsules, pairs: IntArray) -> Array:
    """Room (..., Q) [m] between capsules of two limbs, below zero where they touch."""
    a, b = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
    apart = np.linalg.norm(limbs_ways(links, pairs), axis=-1)
    return np.asarray(apart - links.radius[a] - links.radius[b])


def limbs_ways(links: Capsules, pairs: IntArray) -> Array:
    """Shortest ways (..., Q, 3) [m] to the first capsule's axis from that of the second."""
    a, b = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
    p, q = links.starts[..., a[0], a[1], :], links.ends[..., a[0], a[1], :]
    r, s = links.starts[..., b[0], b[1], :], links.ends[..., b[0], b[1], :]
    return segment_ways(p, q, r, s)


def segment_distances(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Distances (...) of segments p q and r s (..., 3), zero where they cross."""
    return np.asarray(np.linalg.norm(segment_ways(p, q, r, s), axis=-1))


def segment_ways(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Shortest ways (..., 3) to segments p q from segments r s (..., 3), zero where they cross.

    The best place on one for the best on the other (C. Ericson, 2004, section 5.1.9).
    """
    u, v, w = q - p, s - r, p - r
    tiny = np.finfo(float).tiny
    a, e = (u * u).sum(-1), (v * v).sum(-1)
    b, c, f = (u * v).sum(-1), (u * w).sum(-1), (v * w).sum(-1)
    det = a * e - b * b
    open_ = det > 1e-12 * a * e
    x = np.clip(np.where(open_, b * f - c * e, 0.0) / np.where(open_, det, 1.0), 0.0, 1.0)
    y = np.clip((b * x + f) / np.maximum(e, tiny), 0.0, 1.0)
    x = np.clip((b * y - c) / np.maximum(a, tiny), 0.0, 1.0)
    return np.asarray(w + x[..., None] * u - y[..., None] * v)
