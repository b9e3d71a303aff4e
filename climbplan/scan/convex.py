"""Polygons with holes as few convex pieces: triangles merged where they stay convex."""

from __future__ import annotations

import heapq

import numpy as np
import shapely

from climbplan.arrays import Array

_CONVEX = 1e-9  # [m^2] twice the area by which a corner may turn inwards


def convex_pieces(polygon: shapely.Polygon) -> list[Array]:
    """Corners (K, 2) of convex pieces, anticlockwise, that cover a polygon and do not overlap.

    A constrained Delaunay triangulation whose pieces are joined over their longest common edges
    as long as the union is convex (S. Hertel and K. Mehlhorn, 1983).
    """
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    if not len(triangles):
        return []
    corners = np.array([shapely.get_coordinates(t)[:3] for t in triangles])
    area = crossed(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = np.where(area[:, None, None] < 0, corners[:, ::-1], corners)
    points, number = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    pieces: dict[int, list[int]] = {
        i: list(t) for i, t in enumerate(sorted(_rolled(t) for t in number.reshape(-1, 3).tolist()))
    }
    owner: dict[tuple[int, int], int] = {}
    for i, piece in pieces.items():
        for a, b in zip(piece, piece[1:] + piece[:1], strict=True):
            owner[a, b] = i
    queue = [
        (-float(np.linalg.norm(points[a] - points[b])), a, b)
        for a, b in owner
        if a < b and (b, a) in owner
    ]
    heapq.heapify(queue)
    while queue:
        _, a, b = heapq.heappop(queue)
        one, other = owner.get((a, b)), owner.get((b, a))
        if one is None or other is None or one == other:
            continue
        joined = _joined(pieces[one], pieces[other], a, b)
        if joined is None or not _is_convex(points, joined):
            continue
        del owner[a, b], owner[b, a]
        for c, d in zip(joined, joined[1:] + joined[:1], strict=True):
            owner[c, d] = one
        pieces[one] = joined
        del pieces[other]
    return [_without_flat_corners(_hull(points[piece])) for piece in pieces.values()]


def peeled(polygon: shapely.Polygon, most: int, least: float) -> list[Array]:
    """Up to `most` large convex pieces of a polygon, of at least `least` [m^2].

    Each is what is left when the deepest corner that turns inwards is cut away, again and again,
    along the line that leaves the most; the next is looked for in the rest. They need not cover it.
    """
    pieces: list[Array] = []
    rest = [polygon]
    while rest and len(pieces) < most:
        largest = max(range(len(rest)), key=lambda i: rest[i].area)
        part = rest.pop(largest)
        if part.area < least:
            break
        piece = _cut_convex(part)
        if piece.area < least:
            continue
        pieces.append(_without_flat_corners(_anticlockwise(piece)))
        left = shapely.difference(part, piece.buffer(1e-6))
        rest += [p for p in shapely.get_parts(left) if p.geom_type == "Polygon"]
    return pieces


def _beside_holes(polygon: shapely.Polygon) -> shapely.Polygon:
    """What is left on one side of every hole, the largest first, on the side where most is."""
    while len(polygon.interiors):
        a, b, c, d = max(polygon.interiors, key=lambda hole: shapely.Polygon(hole).area).bounds
        low, left, high, right = polygon.bounds
        sides = (
            (low, left, a, right),
            (c, left, high, right),
            (low, left, high, b),
            (low, d, high, right),
        )
        cuts = (shapely.intersection(polygon, shapely.box(*side)) for side in sides)
        parts = [p for cut in cuts for p in shapely.get_parts(cut) if p.geom_type == "Polygon"]
        if not parts:
            return shapely.Polygon()
        polygon = max(parts, key=lambda part: part.area)
    return polygon


def _anticlockwise(polygon: shapely.Polygon) -> Array:
    return np.asarray(shapely.get_coordinates(shapely.orient_polygons(polygon).exterior)[:-1])


def _cut_convex(polygon: shapely.Polygon) -> shapely.Polygon:
    """A polygon with its holes and pockets cut away until it is convex."""
    polygon = _beside_holes(polygon)
    far = 4 * float(np.hypot(*np.subtract(polygon.bounds[2:], polygon.bounds[:2])))
    while True:
        corners = _anticlockwise(polygon)
        before, after = (
            corners - np.roll(corners, 1, axis=0),
            np.roll(corners, -1, axis=0) - corners,
        )
        turn = crossed(before, after)
        inwards = np.flatnonzero(turn < -_CONVEX)
        if not len(inwards):
            return shapely.convex_hull(polygon)
        rim = polygon.convex_hull.exterior
        depth = shapely.distance(shapely.points(corners[inwards]), rim)
        deepest = int(inwards[int(np.argmax(np.round(depth, 9)))])
        corner = corners[deepest]
        foot = rim.interpolate(rim.project(shapely.Point(corner)))
        lid = np.array([corner[1] - foot.y, foot.x - corner[0]])
        ways = np.array([before[deepest], after[deepest], lid])
        length = np.hypot(*ways.T)
        along = (far / np.maximum(length, 1e-12))[:, None] * ways
        along = np.repeat(along[length >= 1e-12], 2, axis=0)
        out = np.column_stack([-along[:, 1], along[:, 0]])
        out[1::2] *= -1.0  # either side of each line
        ends = corner - along, corner + along, corner + along + out, corner - along + out
        part = _largest_part(polygon, np.stack(ends, 1), _areas_beyond(corners - corner, out))
        if part is None or part.area > polygon.area * (1 - 1e-12):
            return shapely.convex_hull(shapely.Point(corner))
        polygon = part


def _largest_part(polygon: shapely.Polygon, quads: Array, bounds: Array) -> shapely.Polygon | None:
    """The largest piece of a polygon in one of some quadrilaterals (Q, 4, 2).

    bounds (Q,): areas that are there in all, in whose order they are looked at: mostly one is.
    """
    best, most = None, 0.0
    for k in np.argsort(-bounds, kind="stable"):
        if best is not None and bounds[k] * (1 + 1e-9) < most:
            break
        cut = shapely.intersection(polygon, shapely.polygons(quads[k]))
        for part in shapely.get_parts(cut):
            if part.geom_type == "Polygon" and part.area > most:
                best, most = part, part.area
    return best


def _areas_beyond(corners: Array, out: Array) -> Array:
    """(Q,) areas of a polygon (V, 2), anticlockwise, on one side of lines through the origin.

    By Green's theorem, as a line through the origin adds nothing to it. out (Q, 2): that side.
    """
    after = np.roll(corners, -1, axis=0)
    here, there = corners @ out.T, after @ out.T  # (V, Q)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = here / (here - there)
    crosses = (here > 0) != (there > 0)
    start = np.where(crosses & (here <= 0), crossing, 0.0)
    end = np.where(crosses & (there <= 0), crossing, 1.0)
    share = np.where((here > 0) | (there > 0), end - start, 0.0)
    # a point s on to one t of an edge: the cross product is (t - s) times that of its ends
    return np.asarray((share * crossed(corners, after)[:, None]).sum(axis=0) / 2)


def crossed(first: Array, second: Array) -> Array:
    """z of the cross products of vectors (..., 2) in a plane."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _rolled(triangle: list[int]) -> tuple[int, ...]:
    first = triangle.index(min(triangle))
    return tuple(triangle[first:] + triangle[:first])


def _joined(one: list[int], other: list[int], a: int, b: int) -> list[int] | None:
    """Two pieces as one across the edge that runs from a to b in the first."""
    i, j = one.index(a), other.index(b)
    # first from b round to a, then the second from a round to b, its ends being there already
    around = [*one[i + 1 :], *one[: i + 1]]
    rest = [*other[j + 1 :], *other[: j + 1]]  # starts after b: a, ..., b
    if rest[0] != a or around[0] != b:
        return None
    joined = around + rest[1:-1]
    return joined if len(set(joined)) == len(joined) else None


def _is_convex(points: Array, piece: list[int]) -> bool:
    corners = points[piece]
    edges = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edges, -1, axis=0)
    return bool((crossed(edges, after) >= -_CONVEX).all())


def _hull(corners: Array) -> Array:
    """Corners of a polygon that is convex but for rounding, of which short edges turn far."""
    edges = np.roll(corners, -1, axis=0) - corners
    if (crossed(edges, np.roll(edges, -1, axis=0)) >= 0).all():
        return corners
    return _anticlockwise(shapely.convex_hull(shapely.Polygon(corners)))


def _without_flat_corners(corners: Array) -> Array:
    """A convex polygon without corners that its neighbours' line passes within a micrometre."""
    kept = corners
    while len(kept) > 3:
        before, after = np.roll(kept, 1, axis=0), np.roll(kept, -1, axis=0)
        span = after - before
        off = crossed(span, kept - before) / np.maximum(np.linalg.norm(span, axis=1), 1e-12)
        near = np.linalg.norm(after - kept, axis=1) < 1e-6
        drop = int(np.argmin(np.where(near, -1.0, np.abs(off))))
        if not near[drop] and abs(off[drop]) > 1e-6:
            break
        kept = np.delete(kept, drop, axis=0)
    return kept
