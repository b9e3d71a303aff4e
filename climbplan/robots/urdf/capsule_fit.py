"""Capsules of least volume that contain the pieces of a URDF's collision geometry.

A capsule of half length h about the longest axis of a box, or about a cylinder's, holds it with
R^2 = q + u^2, where u = a - h, a is the half length of the piece and q the square of how far its
edges lie from that axis. Its volume 2 pi R^2 h + 4/3 pi R^3 is least where

    2 u (a - u) - q - u^2 + 2 u R = 0,

which has one root between 0 and a if 3 a^2 > q; otherwise it is a sphere.

A flat box or disc, such as the housing of a knee's motor, is cut into strips about as wide as it is
thick, each with a capsule of its own. One capsule round a disc of radius 60 mm and thickness 40 mm
would reach 43 mm beyond its faces; three reach 9 mm beyond its faces, and 35 mm beyond its rim.

A capsule that reaches below a spherical foot would collide with every surface that the foot stands
on. Therefore a piece of the last link that leaves the sphere of its foot by at most
`_FOOT_TOLERANCE` is replaced by that sphere, and the end of a mesh at the toe is cut off and has a
capsule of its own: a single capsule around a leg with a blunt end is as thick as its knee and
reaches below its foot.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.robots.model import MountedCapsules
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import LegAtZero
from climbplan.robots.urdf.shapes import Shape

LIMB_RADIUS = 0.02  # [m] without collision geometry
_ROUNDED = 4  # decimals [m] of the ends round a mesh, so that every machine has the same
_KEPT = 256  # meshes whose capsules are remembered
_FLAT = 5  # fewest points of which there is a hull
_FLATNESS = 1.5  # ratio of width to thickness from which a piece is cut into strips
_MAX_STRIPS = 4  # of one piece
_FOOT_TOLERANCE = 1.5e-3  # [m] by which a foot's geometry may leave the sphere that stands for it
_MIN_LENGTH_TO_WIDTH = 2.0  # from which the end of a mesh is cut off
_THINNEST = 1e-3  # [m] a mesh below that is flat
_FAN = 60  # directions across a mesh in which its width is measured
_SAME_SIZE = 9  # decimals [m] to which sides are compared, so that every machine sorts them alike


def capsules_of(shape: Shape) -> list[tuple[Array, float]]:
    """Return capsules whose union contains one piece: ends (2, 3) of each axis, and radius [m].

    A flat box or cylinder is cut across its width into strips, each with a capsule of its own.
    """
    if shape.axis is None:
        return [capsule_of(shape)]
    sides = _sides(shape)
    along = shape.points @ sides.T  # (P, 3)
    _, width, thickness = np.ptp(along, axis=0)
    if width < _FLATNESS * thickness:
        return [capsule_of(shape)]
    count = min(round(width / max(thickness, 1e-9)), _MAX_STRIPS)
    cuts = np.linspace(along[:, 1].min(), along[:, 1].max(), count + 1)
    edges = np.stack([along[index] for index in np.triu_indices(len(along), 1)], axis=1)
    return [_round_box(*_box(_slab(along, edges, *bounds), sides)) for bounds in pairwise(cuts)]


def end_capsules(shape: Shape, toe: Array, foot_radius: float) -> list[tuple[Array, float]]:
    """Return capsules whose union contains one piece of the link that ends in a spherical foot.

    A piece that leaves the sphere of the foot by at most `_FOOT_TOLERANCE` is replaced by that
    sphere, which then does not contain all of it.

    Args:
        shape: The piece.
        toe: Centre of the foot (3,), in the frame of the piece [m].
        foot_radius: Its radius [m].
    """
    max_distance = float(np.linalg.norm(shape.points - toe, axis=1).max()) + shape.radius
    if max_distance <= foot_radius + _FOOT_TOLERANCE:
        return [(np.stack([toe, toe]), foot_radius)]
    if shape.axis is not None or len(shape.points) < _FLAT:
        return capsules_of(shape)
    packed = np.ascontiguousarray(shape.points, float).tobytes()
    sections = _sections(packed, tuple(float(x) for x in toe))
    return [capsule_of(replace(shape, points=section)) for section in sections]


@lru_cache(maxsize=_KEPT)
def _sections(packed: bytes, toe: tuple[float, ...]) -> tuple[Array, ...]:
    """Return the points (Q, 3) of a mesh without its end at the toe, and those of that end.

    packed: its points. The end is as long as the mesh is thick. A mesh that is not long, or flat,
    stays whole.
    """
    points = np.frombuffer(packed).reshape(-1, 3)
    long = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    # Widths in a fan of directions that every machine has the same
    across = np.eye(3)[np.argmin(np.abs(long))]
    across = across - (across @ long) * long
    sides = np.stack([across / np.linalg.norm(across), long, np.zeros(3)])
    sides[2] = np.cross(sides[0], long)
    angle = np.linspace(0.0, np.pi, _FAN, endpoint=False)
    fan = np.stack([np.cos(angle), np.sin(angle)]).T @ sides[::2]
    widths = np.ptp(points @ fan.T, axis=0)
    along = points @ sides.T
    low, high = along[:, 1].min(), along[:, 1].max()
    thick = widths.min()
    if high - low < _MIN_LENGTH_TO_WIDTH * widths.max() or thick < _THINNEST:
        return (points,)
    try:
        hull = ConvexHull(along)
    except QhullError:
        return (points,)
    sides_of = hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = along[np.unique(np.sort(sides_of, axis=1), axis=0)]  # (E, 2, 3)
    is_toe_at_top = float(np.array(toe) @ long) > (low + high) / 2
    cuts = [low, high - thick, high] if is_toe_at_top else [low, low + thick, high]
    corners = along[hull.vertices]
    return tuple(_slab(corners, edges, *bounds) @ sides for bounds in pairwise(cuts))


def capsule_of(shape: Shape) -> tuple[Array, float]:
    """Ends (2, 3) of the axis and radius [m] of the capsule round one piece of geometry."""
    if len(shape.points) <= 2:  # a sphere or a capsule
        return shape.points[[0, -1]], shape.radius
    if shape.axis is None:
        return _round_points(np.ascontiguousarray(shape.points, float).tobytes(), shape.radius)
    return _round_box(*shape.axis)


def _sides(shape: Shape) -> Array:
    """Return unit vectors (3, 3) along a box or a cylinder as rows, along its longest side first.

    Across a cylinder, one goes through the first corner of its rim, one at right angles to that.
    """
    assert shape.axis is not None
    points = shape.points
    if shape.is_cylinder:
        middle, along, _ = shape.axis
        rim = points[0] - middle
        across = rim - (rim @ along) / (along @ along) * along
        sides = np.stack([along, np.cross(along, across), across])
    else:  # corner 0 of a box, and those that differ from it along x, y and z
        sides = points[[4, 2, 1]] - points[0]
    sides = sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-12)
    extent = np.ptp(points @ sides.T, axis=0).round(_SAME_SIZE)
    return np.asarray(sides[np.argsort(-extent, kind="stable")])


def _slab(points: Array, edges: Array, lower: float, upper: float) -> Array:
    """Return points (Q, 3) whose convex hull is a convex body between two values of y.

    points: corners (P, 3) of the body; edges: (E, 2, 3) at least those of the body.
    """
    one, other = edges[:, 0], edges[:, 1]
    found = [points[(points[:, 1] >= lower) & (points[:, 1] <= upper)]]
    for cut in (lower, upper):
        crossing = (one[:, 1] - cut) * (other[:, 1] - cut) < 0
        a, b = one[crossing], other[crossing]
        share = (cut - a[:, 1]) / (b[:, 1] - a[:, 1])
        found.append(a + share[:, None] * (b - a))
    return np.concatenate(found)


def _box(points: Array, sides: Array) -> tuple[Array, Array, float]:
    """Return the bounding box of points (P, 3) along sides (3, 3), as `Shape.axis` describes it."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    half = (upper - lower) / 2
    longest = int(np.argmax(half))
    square = float((half**2).sum() - half[longest] ** 2)
    return (lower + upper) / 2 @ sides, half[longest] * sides[longest], square


def _round_box(middle: Array, half: Array, square: float) -> tuple[Array, float]:
    """Return the capsule of least volume round a box or a cylinder, given as by `Shape.axis`."""
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
    foot_radius: float = 0.0,
) -> MountedCapsules | None:
    """Capsules of all legs, body frame; None where all links are alike and straight.

    stated: radius by joint [m] of links that are straight from joint to joint; common: of all that
    are not stated, in place of their geometry. A link without geometry has none, but the last: it
    is straight and as thick as the one before it, or as `LIMB_RADIUS`. soles: ends (N, 2, 3) of the
    axes and the radius of what takes the place of last links, of flat feet. foot_radius:
    of spherical feet [m], else zero.
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
            fitted: list[tuple[Array, float]] = []
            for shape in (shape for shape in shapes if shape.joint == joint):
                if foot_radius > 0 and number == width - 1:
                    fitted += end_capsules(shape, points[-1] + centre, foot_radius)
                else:
                    fitted += capsules_of(shape)
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
