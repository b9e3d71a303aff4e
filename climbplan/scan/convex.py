"""Decomposition of polygons with holes into few convex pieces."""

from __future__ import annotations

import heapq

import numpy as np
import shapely

from climbplan.arrays import Array

_CONVEX_TOLERANCE = 1e-9  # [m^2] twice the area by which a corner may turn inwards


def decompose_convex(polygon: shapely.Polygon) -> list[Array]:
    """Decompose a polygon into convex pieces that cover it and do not overlap.

    The triangles of a constrained Delaunay triangulation are joined over their longest common edges
    as long as the union is convex (S. Hertel and K. Mehlhorn, 1983).

    Returns:
        Corners (K, 2) of each piece, anticlockwise.
    """
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    if not len(triangles):
        return []
    corners = np.array([shapely.get_coordinates(t)[:3] for t in triangles])
    area = compute_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = np.where(area[:, None, None] < 0, corners[:, ::-1], corners)
    points, number = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    pieces: dict[int, list[int]] = {
        i: list(t)
        for i, t in enumerate(
            sorted(_rotate_smallest_first(t) for t in number.reshape(-1, 3).tolist())
        )
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
        first, second = owner.get((a, b)), owner.get((b, a))
        if first is None or second is None or first == second:
            continue
        union = _merge_pieces(pieces[first], pieces[second], a, b)
        if union is None or not _is_convex(points, union):
            continue
        del owner[a, b], owner[b, a]
        for c, d in zip(union, union[1:] + union[:1], strict=True):
            owner[c, d] = first
        pieces[first] = union
        del pieces[second]
    return [_remove_flat_corners(_make_convex(points[piece])) for piece in pieces.values()]


def extract_convex_pieces(
    polygon: shapely.Polygon, max_pieces: int, min_area: float
) -> list[Array]:
    """Extract up to `max_pieces` large convex pieces, each of at least `min_area` [m^2].

    A piece remains when the deepest reflex corner is cut away, repeatedly, along the line that
    leaves
    the most. The next piece comes from the remainder. They need not cover the polygon.
    """
    pieces: list[Array] = []
    remainder = [polygon]
    while remainder and len(pieces) < max_pieces:
        largest_index = max(range(len(remainder)), key=lambda i: remainder[i].area)
        polygon_part = remainder.pop(largest_index)
        if polygon_part.area < min_area:
            break
        piece = _cut_convex(polygon_part)
        if piece.area < min_area:
            continue
        pieces.append(_remove_flat_corners(_order_anticlockwise(piece)))
        left = shapely.difference(polygon_part, piece.buffer(1e-6))
        remainder += [p for p in shapely.get_parts(left) if p.geom_type == "Polygon"]
    return pieces


def _cut_off_holes(polygon: shapely.Polygon) -> shapely.Polygon:
    """Return what remains on one side of every hole, the largest first, on the largest side."""
    while len(polygon.interiors):
        a, b, c, d = max(polygon.interiors, key=lambda hole: shapely.Polygon(hole).area).bounds
        low, lower_y, high, right = polygon.bounds
        sides = (
            (low, lower_y, a, right),
            (c, lower_y, high, right),
            (low, lower_y, high, b),
            (low, d, high, right),
        )
        cuts = (shapely.intersection(polygon, shapely.box(*side)) for side in sides)
        candidates = [p for cut in cuts for p in shapely.get_parts(cut) if p.geom_type == "Polygon"]
        if not candidates:
            return shapely.Polygon()
        polygon = max(candidates, key=lambda part: part.area)
    return polygon


def _order_anticlockwise(polygon: shapely.Polygon) -> Array:
    """Return the corners of a polygon, anticlockwise."""
    return np.asarray(shapely.get_coordinates(shapely.orient_polygons(polygon).exterior)[:-1])


def _cut_convex(polygon: shapely.Polygon) -> shapely.Polygon:
    """Cut away holes and pockets of a polygon until it is convex."""
    polygon = _cut_off_holes(polygon)
    far = 4 * float(np.hypot(*np.subtract(polygon.bounds[2:], polygon.bounds[:2])))
    while True:
        corners = _order_anticlockwise(polygon)
        before, after = (
            corners - np.roll(corners, 1, axis=0),
            np.roll(corners, -1, axis=0) - corners,
        )
        turn = compute_cross(before, after)
        inwards = np.flatnonzero(turn < -_CONVEX_TOLERANCE)
        if not len(inwards):
            return shapely.convex_hull(polygon)
        rim = polygon.convex_hull.exterior
        depth = shapely.distance(shapely.points(corners[inwards]), rim)
        deepest = int(inwards[int(np.argmax(np.round(depth, 9)))])
        corner = corners[deepest]
        foot = rim.interpolate(rim.project(shapely.Point(corner)))
        lid = np.array([corner[1] - foot.y, foot.x - corner[0]])
        directions = np.array([before[deepest], after[deepest], lid])
        length = np.hypot(*directions.T)
        lines = (far / np.maximum(length, 1e-12))[:, None] * directions
        lines = np.repeat(lines[length >= 1e-12], 2, axis=0)
        out = np.column_stack([-lines[:, 1], lines[:, 0]])
        out[1::2] *= -1.0  # either side of each line
        ends = corner - lines, corner + lines, corner + lines + out, corner - lines + out
        remainder = _select_largest_part(
            polygon, np.stack(ends, 1), _compute_areas_beyond(corners - corner, out)
        )
        if remainder is None or remainder.area > polygon.area * (1 - 1e-12):
            return shapely.convex_hull(shapely.Point(corner))
        polygon = remainder


def _select_largest_part(
    polygon: shapely.Polygon, quads: Array, bounds: Array
) -> shapely.Polygon | None:
    """Return the largest piece of a polygon in one of some quadrilaterals (Q, 4, 2).

    bounds (Q,): upper bounds of the areas, in whose order they are tried: mostly one suffices.
    """
    best, max_area = None, 0.0
    for k in np.argsort(-bounds, kind="stable"):
        if best is not None and bounds[k] * (1 + 1e-9) < max_area:
            break
        cut = shapely.intersection(polygon, shapely.polygons(quads[k]))
        for polygon_part in shapely.get_parts(cut):
            if polygon_part.geom_type == "Polygon" and polygon_part.area > max_area:
                best, max_area = polygon_part, polygon_part.area
    return best


def _compute_areas_beyond(corners: Array, out: Array) -> Array:
    """Return the areas (Q,) of a polygon (V, 2) on one side of lines through the origin.

    By Green's theorem, to which a line through the origin adds nothing. The polygon is
    anticlockwise.
    out (Q, 2): directions of the sides.
    """
    after = np.roll(corners, -1, axis=0)
    start_side, end_side = corners @ out.T, after @ out.T  # (V, Q)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start_side / (start_side - end_side)
    crosses = (start_side > 0) != (end_side > 0)
    start = np.where(crosses & (start_side <= 0), crossing, 0.0)
    end = np.where(crosses & (end_side <= 0), crossing, 1.0)
    fraction = np.where((start_side > 0) | (end_side > 0), end - start, 0.0)
    # a point s on to one t of an edge: the cross product is (t - s) times that of its ends
    return np.asarray((fraction * compute_cross(corners, after)[:, None]).sum(axis=0) / 2)


def compute_cross(first: Array, second: Array) -> Array:
    """Return z of the cross products of vectors (..., 2) in a plane."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _rotate_smallest_first(triangle: list[int]) -> tuple[int, ...]:
    """Return the corners of a triangle with the smallest first."""
    first = triangle.index(min(triangle))
    return tuple(triangle[first:] + triangle[:first])


def _merge_pieces(first: list[int], second: list[int], a: int, b: int) -> list[int] | None:
    """Return two pieces as one across the edge that runs from a to b in the first.

    None where they would touch themselves.
    """
    i, j = first.index(a), second.index(b)
    # first from b round to a, then the second from a round to b, its ends being there already
    first_path = [*first[i + 1 :], *first[: i + 1]]
    second_path = [*second[j + 1 :], *second[: j + 1]]  # starts after b: a, ..., b
    if second_path[0] != a or first_path[0] != b:
        return None
    union = first_path + second_path[1:-1]
    return union if len(set(union)) == len(union) else None


def _is_convex(points: Array, piece: list[int]) -> bool:
    """Return whether a piece is convex."""
    corners = points[piece]
    edges = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edges, -1, axis=0)
    return bool((compute_cross(edges, after) >= -_CONVEX_TOLERANCE).all())


def _make_convex(corners: Array) -> Array:
    """Return the corners of a polygon that is convex but for rounding at short edges."""
    edges = np.roll(corners, -1, axis=0) - corners
    if (compute_cross(edges, np.roll(edges, -1, axis=0)) >= 0).all():
        return corners
    return _order_anticlockwise(shapely.convex_hull(shapely.Polygon(corners)))


def _remove_flat_corners(corners: Array) -> Array:
    """Return a convex polygon without corners within a micrometre of their neighbours' line."""
    while len(corners) > 3:
        before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
        span = after - before
        off = compute_cross(span, corners - before) / np.maximum(
            np.linalg.norm(span, axis=1), 1e-12
        )
        is_repeated = np.linalg.norm(after - corners, axis=1) < 1e-6
        drop = int(np.argmin(np.where(is_repeated, -1.0, np.abs(off))))
        if not is_repeated[drop] and abs(off[drop]) > 1e-6:
            break
        corners = np.delete(corners, drop, axis=0)
    return corners
