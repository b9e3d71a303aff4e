"""Capsules that hold collision geometry: one round each piece of it, of least volume.

A capsule of half length h about the longest axis of a box, or about a cylinder's, holds it with
R^2 = q + u^2, where u = a - h, a is the half length of the piece and q the square of how far its
edges lie from that axis. Its volume 2 pi R^2 h + 4/3 pi R^3 is least where

    2 u (a - u) - q - u^2 + 2 u R = 0,

which has one root between 0 and a if 3 a^2 > q; otherwise it is a sphere.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.spatial import ConvexHull, QhullError

from climbplan.robots.model import MountedCapsules
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import LegAtZero
from climbplan.robots.urdf.shapes import Shape

LIMB_RADIUS = 0.02  # [m] without collision geometry
_ROUNDED = 4  # decimals [m] of the ends round a mesh, so that every machine has the same
_KEPT = 256  # meshes whose capsules are remembered
_FLAT = 5  # fewest points of which there is a hull


def capsule_of(shape: Shape) -> tuple[Array, float]:
    """Ends (2, 3) of the axis and radius [m] of the capsule round one piece of geometry."""
    if len(shape.points) <= 2:  # a sphere or a capsule
        return shape.points[[0, -1]], shape.radius
    if shape.axis is None:
        return _round_points(np.ascontiguousarray(shape.points, float).tobytes(), shape.radius)
    middle, half, square = shape.axis
    a = float(np.linalg.norm(half))
    u = a
    if 3 * a * a > square:
        u = brentq(lambda u: _slope(u, a, square), 0.0, a, xtol=1e-12)
    along = half * (1 - u / a)
    return np.stack([middle - along, middle + along]), float(np.sqrt(square + u * u))


def leg_capsules(
    chain: SerialChain,
    legs: list[LegAtZero],
    shapes: list[Shape],
    centre: Array,
    stated: dict[str, float],
    common: float | None,
    soles: tuple[Array, float] | None = None,
) -> MountedCapsules | None:
    """Capsules of all legs, body frame; None where all links are alike and straight.

    stated: radius by joint [m] of links that are straight from joint to joint; common: of all that
    are not stated, in place of their geometry. A link without geometry has none, but the last: it
    is straight and as thick as the one before it, or as `LIMB_RADIUS`. soles: ends (N, 2, 3) of the
    axes and the radius of what takes the place of last links, of flat feet.
    """
    moved = {joint for leg in legs for joint in leg.names}
    if (
        soles is None
        and not stated
        and (common is not None or not any(s.joint in moved for s in shapes))
    ):
        return None
    width = chain.joint_count
    rows: list[list[tuple[int, Array, float]]] = []
    for limb, leg in enumerate(legs):
        points = np.concatenate([chain.joint_zero[limb], chain.toe_zero[limb][None]])
        own: list[tuple[int, Array, float]] = []
        for number, joint in enumerate(leg.names, start=width - len(leg.names)):
            if soles is not None and number == width - 1:
                own.append((number, soles[0][limb], soles[1]))
                continue
            straight = points[number : number + 2]
            radius = stated.get(joint, common)
            if radius is not None:
                own.append((number, straight, radius))
                continue
            fitted = [capsule_of(shape) for shape in shapes if shape.joint == joint]
            own += [(number, _towards(points[-1], ends - centre), r) for ends, r in fitted]
        if not own or own[-1][0] != width - 1:
            own.append((width - 1, points[-2:], own[-1][2] if own else LIMB_RADIUS))
        rows.append(own)
    count = max(map(len, rows))
    full = [row + row[:1] * (count - len(row)) for row in rows]
    return MountedCapsules(
        joint=np.array([[number for number, _, _ in row] for row in full], np.int64),
        ends=np.array([[ends for _, ends, _ in row] for row in full]),
        radius=np.array([[radius for _, _, radius in row] for row in full]),
    )


def _towards(toe: Array, ends: Array) -> Array:
    """The ends (2, 3) with that nearer the toe last."""
    first, last = np.linalg.norm(ends - toe, axis=1)
    return ends if last <= first else ends[::-1]


def _slope(u: float, a: float, square: float) -> float:
    """Half the derivative of the volume by u, over 2 pi."""
    return 2 * u * (a - u) - square - u * u + 2 * u * float(np.sqrt(square + u * u))


@lru_cache(maxsize=_KEPT)
def _round_points(packed: bytes, beyond: float) -> tuple[Array, float]:
    """The same for any points (P, 3), by a local search from their longest direction.

    packed: the points; beyond: [m] that the piece reaches beyond their hull. A robot is built many
    times while it is proposed and planned with, and its meshes are the same each time.
    """
    points = np.frombuffer(packed).reshape(-1, 3)
    if len(points) >= _FLAT:
        with suppress(QhullError):  # they lie in a plane
            points = points[ConvexHull(points).vertices]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    _, _, directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    best: tuple[float, Array] | None = None
    for direction in directions:
        along = (points - middle) @ direction
        inner = max(np.ptp(along) / 2 - np.ptp((points - middle) @ directions[-1]) / 2, 0.0)
        start = np.concatenate([middle - inner * direction, middle + inner * direction])
        found = minimize(
            lambda ends: _volume(points, ends.reshape(2, 3), beyond),
            start,
            method="Nelder-Mead",
            options={"maxfev": 1500, "xatol": 1e-5, "fatol": 1e-9},
        )
        if best is None or found.fun < best[0]:
            best = float(found.fun), np.asarray(found.x)
    assert best is not None
    ends = np.round(best[1].reshape(2, 3), _ROUNDED)
    ends.setflags(write=False)  # of all who ask
    return ends, _radius(points, ends) + beyond


def _volume(points: Array, ends: Array, radius: float) -> float:
    thick = _radius(points, ends) + radius
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return float(np.pi * thick**2 * (length + 4 / 3 * thick))


def _radius(points: Array, ends: Array) -> float:
    """How far points lie from a segment at most [m]."""
    along = ends[1] - ends[0]
    square = float(along @ along)
    share = np.clip((points - ends[0]) @ along / square, 0.0, 1.0) if square > 0 else np.zeros(1)
    return float(np.linalg.norm(points - ends[0] - share[:, None] * along, axis=1).max())
