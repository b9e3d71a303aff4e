"""Clearance between parts of a robot, by the capsules and boxes that contain them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from climbplan.arrays import Array, IntArray
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

_NUM_SAMPLES = 60  # postures that show which parts always touch
_ALWAYS_RATIO = 0.5  # of these, in which a pair touches
_HIP_RADIUS = 0.01  # [m] within which the joints of a hip lie
_NUM_AXIS_POINTS = 17  # tested along a capsule


def list_clearance_pairs(robot: Robot, links: Capsules) -> tuple[IntArray, IntArray]:
    """Return the pairs that have to keep apart: of limbs and the body (B, 4), of two limbs (Q, 4).

    A row has limb and capsule, and limb and capsule or -1 and 0 for the body. The first link of a
    limb is joined with the body, and links of one limb are kept apart by joint bounds. Capsules
    around hips are wider than the parts, so hips are not tested with the body and one another:
    first
    links, and those further out while their joints coincide.
    """
    count, limbs = links.radius.shape[1], range(robot.limb_count)
    first, hip = robot.has_joint.argmax(axis=1), _find_hip_links(robot)
    ignored = {tuple(row) for row in robot.touching.tolist()}
    fixed = first if robot.capsules is None else hip
    to_body = [(i, c, -1, 0) for i in limbs for c in range(count) if links.link[i, c] > fixed[i]]
    between = [
        (i, c, other_limb, other_capsule)
        for i in limbs
        for other_limb in range(i + 1, robot.limb_count)
        for c in range(count)
        for other_capsule in range(count)
        if robot.capsules is None
        or links.link[i, c] > hip[i]
        or links.link[other_limb, other_capsule] > hip[other_limb]
    ]

    def exclude_ignored(pairs: list[tuple[int, int, int, int]]) -> IntArray:
        return np.array([pair for pair in pairs if pair not in ignored], np.int64).reshape(-1, 4)

    return exclude_ignored(to_body), exclude_ignored(between)


def _find_hip_links(robot: Robot) -> IntArray:
    """Return the last link (N,) of each limb that is a part of its hip."""
    hip = robot.has_joint.argmax(axis=1)
    if isinstance(robot.mechanism, SerialChain):
        joints = robot.mechanism.joint_zero
        for limb, first in enumerate(hip.copy()):
            is_near = (
                np.linalg.norm(joints[limb, first:] - joints[limb, first], axis=-1) < _HIP_RADIUS
            )
            hip[limb] = first + max(int(np.logical_and.accumulate(is_near).sum()) - 2, 0)
    return np.asarray(hip, np.int64)


def find_always_touching(robot: Robot, body_parts: Sequence[Array]) -> IntArray:
    """Return pairs (T, 4) that touch in most postures within joint bounds.

    Args:
        robot: The robot.
        body_parts: Corners (V, 3) of convex parts of the body [m].
    """
    fraction = np.random.default_rng(0).random((_NUM_SAMPLES, robot.limb_count, robot.joint_count))
    low, high = np.clip(robot.joint_lower, -np.pi, np.pi), np.clip(robot.joint_upper, -np.pi, np.pi)
    links = limb_capsules(robot, low + fraction * (high - low))
    body, limbs = list_clearance_pairs(robot, links)
    clearance = np.concatenate(
        [compute_body_clearance(links, body, body_parts), compute_limb_clearance(links, limbs)],
        axis=-1,
    )
    touch = (clearance < 0).mean(axis=0) > _ALWAYS_RATIO
    return np.asarray(np.concatenate([body, limbs])[touch])


def compute_body_clearance(links: Capsules, pairs: IntArray, body_parts: Sequence[Array]) -> Array:
    """Return lower bounds (P, B) of the clearance of links and body [m], at points along axes.

    A point is at least as far from a convex part as from the plane of any of its faces.

    Args:
        links: The capsules of P poses.
        pairs: Limb and capsule, and -1 and 0 for the body, (B, 4).
        body_parts: Corners (V, 3) of convex parts of the body [m].
    """
    fractions = np.linspace(0.0, 1.0, _NUM_AXIS_POINTS)[:, None]
    limb_and_capsule = pairs[:, 0], pairs[:, 1]
    starts, ends = (
        v[..., limb_and_capsule[0], limb_and_capsule[1], None, :]
        for v in (links.starts, links.ends)
    )
    points = starts + fractions * (ends - starts)  # (P, B, S, 3)
    flat = np.ascontiguousarray(points.reshape(-1, 3).T)
    distances = np.full(points.shape[:2], np.inf)
    for corners in body_parts:
        faces = ConvexHull(corners).equations
        # Faces along the first axis, over which a maximum of long rows is fast
        distance = (faces[:, :3] @ flat + faces[:, 3:]).max(axis=0).reshape(points.shape[:3])
        distances = np.minimum(distances, distance.min(axis=-1))
    return np.asarray(distances - links.radius[limb_and_capsule])


def compute_limb_clearance(links: Capsules, pairs: IntArray) -> Array:
    """Return the clearance (..., Q) between capsules of two limbs [m], negative where they overlap.

    Args:
        links: The capsules.
        pairs: Limb and capsule, twice, (Q, 4).
    """
    a, b = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
    distance = np.linalg.norm(compute_limb_separations(links, pairs), axis=-1)
    return np.asarray(distance - links.radius[a] - links.radius[b])


def compute_limb_separations(links: Capsules, pairs: IntArray) -> Array:
    """Return the shortest vectors (..., Q, 3) to the first capsule's axis from the second's [m]."""
    a, b = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
    p, q = links.starts[..., a[0], a[1], :], links.ends[..., a[0], a[1], :]
    r, s = links.starts[..., b[0], b[1], :], links.ends[..., b[0], b[1], :]
    return compute_segment_separations(p, q, r, s)


def compute_segment_distances(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the distances (...) between segments p q and r s (..., 3), zero where they cross."""
    return np.asarray(np.linalg.norm(compute_segment_separations(p, q, r, s), axis=-1))


def compute_segment_separations(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the shortest vectors (..., 3) to segments p q from segments r s, zero if they cross.

    The nearest point on one line is projected to the other segment and back (C. Ericson, 2004,
    section 5.1.9).

    Args:
        p: First ends of the first segments (..., 3).
        q: Their second ends.
        r: First ends of the second segments (..., 3).
        s: Their second ends.
    """
    u, v, w = q - p, s - r, p - r
    tiny = np.finfo(float).tiny
    a, e = (u * u).sum(-1), (v * v).sum(-1)
    b, c, f = (u * v).sum(-1), (u * w).sum(-1), (v * w).sum(-1)
    det = a * e - b * b
    is_skew = det > 1e-12 * a * e
    x = np.clip(np.where(is_skew, b * f - c * e, 0.0) / np.where(is_skew, det, 1.0), 0.0, 1.0)
    y = np.clip((b * x + f) / np.maximum(e, tiny), 0.0, 1.0)
    x = np.clip((b * y - c) / np.maximum(a, tiny), 0.0, 1.0)
    return np.asarray(w + x[..., None] * u - y[..., None] * v)
