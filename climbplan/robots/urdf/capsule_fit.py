"""Minimum-volume capsules that contain the pieces of a URDF's collision geometry.

A capsule of half length h about the longest axis of a box, or about a cylinder's, holds it with
R^2 = q + u^2, where u = a - h, a is the half length of the piece and q the squared distance of its
edges from that axis. Its volume 2 pi R^2 h + 4/3 pi R^3 is least where

    2 u (a - u) - q - u^2 + 2 u R = 0,

which has one root between 0 and a if 3 a^2 > q; otherwise it is a sphere.

A flat box or disc, such as the housing of a knee's motor, is cut into strips about as wide as it is
thick, each with a capsule of its own. One capsule around a disc of radius 60 mm and thickness 40 mm
would reach 43 mm beyond its faces; three reach 9 mm beyond its faces, and 35 mm beyond its rim.

A capsule that reaches below a spherical foot would collide with every surface that the foot stands
on. Therefore a piece of the last link that leaves the sphere of its foot by at most
`_FOOT_TOLERANCE` is replaced by that sphere. The end of a mesh at the toe is cut off and has a
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
from climbplan.robots.urdf.shapes import CollisionShape

LIMB_RADIUS = 0.02  # [m] without collision geometry
_DECIMALS = 4  # [m] of the ends of a mesh's capsule, so that every machine has the same
_CACHE_SIZE = 256  # meshes whose capsules are cached
_MIN_HULL_POINTS = 5  # of a mesh with a convex hull
_FLATNESS = 1.5  # ratio of width to thickness from which a piece is cut into strips
_MAX_STRIPS = 4  # of one piece
_FOOT_TOLERANCE = 1.5e-3  # [m] by which a foot's geometry may leave the sphere that stands for it
_MIN_LENGTH_TO_WIDTH = 2.0  # from which the end of a mesh is cut off
_MIN_THICKNESS = 1e-3  # [m] a mesh below that is flat
_NUM_FAN_DIRECTIONS = 60  # across a mesh, in which its width is measured
_SORT_DECIMALS = 9  # [m] to which sides are compared, so that every machine sorts them alike


def fit_strip_capsules(shape: CollisionShape) -> list[tuple[Array, float]]:
    """Return capsules whose union contains one piece: ends (2, 3) of each axis, and radius [m].

    A flat box or cylinder is cut across its width into strips, each with a capsule of its own.
    """
    if shape.axis is None:
        return [fit_capsule(shape)]
    sides = _compute_sides(shape)
    along = shape.points @ sides.T  # (P, 3)
    _, width, thickness = np.ptp(along, axis=0)
    if width < _FLATNESS * thickness:
        return [fit_capsule(shape)]
    count = min(round(width / max(thickness, 1e-9)), _MAX_STRIPS)
    cuts = np.linspace(along[:, 1].min(), along[:, 1].max(), count + 1)
    edges = np.stack([along[index] for index in np.triu_indices(len(along), 1)], axis=1)
    return [
        _fit_box_capsule(*_compute_box(_cut_slab(along, edges, *bounds), sides))
        for bounds in pairwise(cuts)
    ]


def fit_end_capsules(
    shape: CollisionShape, toe: Array, foot_radius: float
) -> list[tuple[Array, float]]:
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
    if shape.axis is not None or len(shape.points) < _MIN_HULL_POINTS:
        return fit_strip_capsules(shape)
    packed = np.ascontiguousarray(shape.points, float).tobytes()
    sections = _cut_sections(packed, tuple(float(x) for x in toe))
    return [fit_capsule(replace(shape, points=section)) for section in sections]


@lru_cache(maxsize=_CACHE_SIZE)
def _cut_sections(packed: bytes, toe: tuple[float, ...]) -> tuple[Array, ...]:
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
    angle = np.linspace(0.0, np.pi, _NUM_FAN_DIRECTIONS, endpoint=False)
    fan = np.stack([np.cos(angle), np.sin(angle)]).T @ sides[::2]
    widths = np.ptp(points @ fan.T, axis=0)
    along = points @ sides.T
    low, high = along[:, 1].min(), along[:, 1].max()
    thick = widths.min()
    if high - low < _MIN_LENGTH_TO_WIDTH * widths.max() or thick < _MIN_THICKNESS:
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
    return tuple(_cut_slab(corners, edges, *bounds) @ sides for bounds in pairwise(cuts))


def fit_capsule(shape: CollisionShape) -> tuple[Array, float]:
    """Return the capsule around one piece of geometry: ends (2, 3) of its axis and radius [m]."""
    if len(shape.points) <= 2:  # a sphere or a capsule
        return shape.points[[0, -1]], shape.radius
    if shape.axis is None:
        return _fit_point_capsule(np.ascontiguousarray(shape.points, float).tobytes(), shape.radius)
    return _fit_box_capsule(*shape.axis)


def _compute_sides(shape: CollisionShape) -> Array:
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
    extent = np.ptp(points @ sides.T, axis=0).round(_SORT_DECIMALS)
    return np.asarray(sides[np.argsort(-extent, kind="stable")])


def _cut_slab(points: Array, edges: Array, lower: float, upper: float) -> Array:
    """Return points (Q, 3) whose convex hull is a convex body between two values of y.

    points: corners (P, 3) of the body; edges: (E, 2, 3) at least those of the body.
    """
    first, second = edges[:, 0], edges[:, 1]
    points_inside = [points[(points[:, 1] >= lower) & (points[:, 1] <= upper)]]
    for cut in (lower, upper):
        crossing = (first[:, 1] - cut) * (second[:, 1] - cut) < 0
        a, b = first[crossing], second[crossing]
        fraction = (cut - a[:, 1]) / (b[:, 1] - a[:, 1])
        points_inside.append(a + fraction[:, None] * (b - a))
    return np.concatenate(points_inside)


def _compute_box(points: Array, sides: Array) -> tuple[Array, Array, float]:
    """Return the bounding box of points (P, 3) along sides (3, 3), as a `CollisionShape.axis`."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    half = (upper - lower) / 2
    longest = int(np.argmax(half))
    square = float((half**2).sum() - half[longest] ** 2)
    return (lower + upper) / 2 @ sides, half[longest] * sides[longest], square


def _fit_box_capsule(middle: Array, half: Array, square: float) -> tuple[Array, float]:
    """Return the capsule of least volume round a box or cylinder, a `CollisionShape.axis`."""
    a = float(np.linalg.norm(half))
    u = a
    if 3 * a * a > square:
        u = brentq(lambda u: _differentiate_volume(u, a, square), 0.0, a, xtol=1e-12)
    along = half * (1 - u / a)
    return np.stack([middle - along, middle + along]), float(np.sqrt(square + u * u))


def fit_leg_capsules(
    chain: SerialChain,
    legs: list[LegAtZero],
    shapes: list[CollisionShape],
    centre: Array,
    *,
    stated: dict[str, float],
    common: float | None,
    soles: tuple[Array, float] | None = None,
    foot_radius: float = 0.0,
) -> MountedCapsules | None:
    """Fit the capsules of all legs, body frame.

    A link without geometry has none, but the last: it is straight and as thick as the one before
    it,
    or as `LIMB_RADIUS`.

    Args:
        chain: N legs of J joints.
        legs: The legs at zero angles.
        shapes: Collision geometry, about the base link.
        centre: Origin of the body frame (3,) from the base link [m].
        stated: Radius by joint [m] of links that are straight from joint to joint.
        common: Radius of all links that are not stated, in place of their geometry [m]; None for
            none.
        soles: Ends (N, 2, 3) of the axes and radius [m] of capsules in place of the last links of
            flat feet; None without flat feet.
        foot_radius: Of spherical feet [m], else zero.

    Returns:
        The capsules; None where all links are alike and straight.
    """
    leg_joints = {joint for leg in legs for joint in leg.names}
    if (
        soles is None
        and not stated
        and (common is not None or not any(s.joint in leg_joints for s in shapes))
    ):
        return None
    width = chain.joint_count
    rows: list[list[tuple[int, Array, float]]] = []
    for limb, leg in enumerate(legs):
        points = np.concatenate([chain.joint_zero[limb], chain.toe_zero[limb][None]])
        capsules: list[tuple[int, Array, float]] = []
        for number, joint in enumerate(leg.names, start=width - len(leg.names)):
            if soles is not None and number == width - 1:
                capsules.append((number, soles[0][limb], soles[1]))
                continue
            straight = points[number : number + 2]
            radius = stated.get(joint, common)
            if radius is not None:
                capsules.append((number, straight, radius))
                continue
            pieces = [shape for shape in shapes if shape.joint == joint]
            sphere_radius = foot_radius if number == width - 1 else 0.0
            fitted = _fit_link(pieces, points[-1] + centre, sphere_radius)
            capsules += [(number, _order_ends(points[-1], ends - centre), r) for ends, r in fitted]
        if not capsules or capsules[-1][0] != width - 1:
            capsules.append((width - 1, points[-2:], capsules[-1][2] if capsules else LIMB_RADIUS))
        rows.append(capsules)
    return _stack_capsules(rows)


def _fit_link(
    pieces: list[CollisionShape], toe: Array, foot_radius: float
) -> list[tuple[Array, float]]:
    """Return the capsules of a link's pieces; foot_radius: of the sphere that ends it [m], or 0."""
    fitted: list[tuple[Array, float]] = []
    for shape in pieces:
        if foot_radius > 0:
            fitted += fit_end_capsules(shape, toe, foot_radius)
        else:
            fitted += fit_strip_capsules(shape)
    return fitted


def _stack_capsules(rows: list[list[tuple[int, Array, float]]]) -> MountedCapsules:
    """Stack the capsules of legs, of which each has as many by repeating its first."""
    count = max(map(len, rows))
    full = [row + row[:1] * (count - len(row)) for row in rows]
    return MountedCapsules(
        joint=np.array([[number for number, _, _ in row] for row in full], np.int64),
        ends=np.array([[ends for _, ends, _ in row] for row in full]),
        radius=np.array([[radius for _, _, radius in row] for row in full]),
    )


def _order_ends(toe: Array, ends: Array) -> Array:
    """Return the ends (2, 3) with the one nearer to the toe last."""
    first, last = np.linalg.norm(ends - toe, axis=1)
    return ends if last <= first else ends[::-1]


def _differentiate_volume(u: float, a: float, square: float) -> float:
    """Return half of the derivative of the volume by u, over 2 pi."""
    return 2 * u * (a - u) - square - u * u + 2 * u * float(np.sqrt(square + u * u))


@lru_cache(maxsize=_CACHE_SIZE)
def _fit_point_capsule(packed: bytes, beyond: float) -> tuple[Array, float]:
    """Return the capsule of least volume around points, by a local search from their main axes.

    packed: points (P, 3); beyond: distance that the piece reaches beyond their hull [m]. A robot is
    built many times while it is proposed and planned with, and its meshes are the same each time.
    """
    points = np.frombuffer(packed).reshape(-1, 3)
    if len(points) >= _MIN_HULL_POINTS:
        with suppress(QhullError):  # they lie in a plane
            points = points[ConvexHull(points).vertices]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    _, _, directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    best: tuple[float, Array] | None = None
    for direction in directions:
        along = (points - middle) @ direction
        inner = max(np.ptp(along) / 2 - np.ptp((points - middle) @ directions[-1]) / 2, 0.0)
        start = np.concatenate([middle - inner * direction, middle + inner * direction])
        result = minimize(
            lambda ends: _compute_volume(points, ends.reshape(2, 3), beyond),
            start,
            method="Nelder-Mead",
            options={"maxfev": 1500, "xatol": 1e-5, "fatol": 1e-9},
        )
        if best is None or result.fun < best[0]:
            best = float(result.fun), np.asarray(result.x)
    assert best is not None
    ends = np.round(best[1].reshape(2, 3), _DECIMALS)
    ends.setflags(write=False)  # the cache is shared
    return ends, _compute_radius(points, ends) + beyond


def _compute_volume(points: Array, ends: Array, radius: float) -> float:
    """Return the volume of the capsule with these ends around points [m^3]."""
    thick = _compute_radius(points, ends) + radius
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return float(np.pi * thick**2 * (length + 4 / 3 * thick))


def _compute_radius(points: Array, ends: Array) -> float:
    """Return the largest distance of points from a segment [m]."""
    axis = ends[1] - ends[0]
    square = float(axis @ axis)
    fraction = np.clip((points - ends[0]) @ axis / square, 0.0, 1.0) if square > 0 else np.zeros(1)
    return float(np.linalg.norm(points - ends[0] - fraction[:, None] * axis, axis=1).max())
