"""Convex free space for the body along its path through a scan.

A polytope is inflated about the body's sweep on a piece of the path. Starting with the nearest
triangle, a plane across the widest gap between sweep and triangle cuts away what is beyond it,
until
no triangle is left inside. The planes touch the triangles, not the sweep. (Compare R. Deits and
R. Tedrake, 2014; S. Liu et al., 2017.)
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import HalfspaceIntersection, QhullError

from climbplan.arrays import Array
from climbplan.scan.distances import compute_triangle_distances

_MAX_LENGTH = 0.4  # [m] of a piece of the path
_MAX_MARGIN = 0.6  # [m] of a region beyond the sweep
_TRIANGLE_GAP = 1e-6  # [m] between regions and triangles


@dataclass(frozen=True)
class ConvexFreeRegion:
    """A convex piece of free space about a piece of the body's path."""

    vertices: Array  # (V, 3) [m]
    min_clearance: float  # [m] from the sweep of the body to the nearest triangle, 0 in collision
    place: Array  # (3,) middle of the piece of the path


def split_path(guide: Array) -> Array:
    """Split a polyline (P, 3) into pieces no longer than a body, with ends (K, 2, 3)."""
    pieces = []
    for start, end in itertools.pairwise(guide):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _MAX_LENGTH - 1e-9)))
        points = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
        pieces += list(itertools.pairwise(points))
    return np.array(pieces).reshape(-1, 2, 3)


def inflate_free_space(ends: Array, hull: Array, corners: Array) -> ConvexFreeRegion:
    """Inflate free space about the sweep of a body's hull along a piece of its path.

    A triangle that the sweep meets gets no plane.

    Args:
        ends: Ends of the piece (2, 3) [m].
        hull: Corners of the body (V, 3) about its origin [m].
        corners: Triangles (T, 3, 3) [m].
    """
    sweep = np.concatenate([end + hull for end in ends])
    low, high = sweep.min(axis=0) - _MAX_MARGIN, sweep.max(axis=0) + _MAX_MARGIN
    A = [np.eye(3), -np.eye(3)]
    b = [high, -low]
    is_near = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(axis=1)
    remaining = corners[is_near]
    starts = np.broadcast_to(ends[0], (len(remaining), 3))
    stops = np.broadcast_to(ends[1], (len(remaining), 3))
    distance = np.array(
        [
            compute_triangle_distances(p[None], q[None], t[None], 1e3)[0]
            for p, q, t in zip(starts, stops, remaining, strict=True)
        ]
    )
    order = np.argsort(distance, kind="stable")
    remaining = remaining[order]
    min_gap = np.inf
    while len(remaining):
        normal, gap = _find_separating_plane(sweep, remaining[0])
        min_gap = min(min_gap, gap)
        if gap <= 0:
            remaining = remaining[1:]
            continue
        offset = float((remaining[0] @ normal).min()) - _TRIANGLE_GAP
        A.append(normal[None])
        b.append(np.array([offset]))
        remaining = remaining[(remaining @ normal).min(axis=1) < offset]
    vertices = _compute_vertices(np.concatenate(A), np.concatenate(b), ends.mean(axis=0))
    return ConvexFreeRegion(vertices, min_gap, ends.mean(axis=0))


def _find_separating_plane(sweep: Array, triangle: Array) -> tuple[Array, float]:
    """Return the unit normal across the gap from a hull of points to a triangle, and its width [m].

    Zero where they meet.
    """
    differences = (triangle[None] - sweep[:, None]).reshape(-1, 3)
    system = np.vstack([differences.T, np.ones(len(differences))])
    weights = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))[0]
    nearest = weights @ differences
    length = float(np.linalg.norm(nearest))
    if length < 1e-9:
        return np.zeros(3), 0.0
    normal = nearest / length
    return normal, float((triangle @ normal).min() - (sweep @ normal).max())


def _compute_vertices(A: Array, b: Array, inside: Array) -> Array:
    """Return the vertices of the polytope A x <= b; none where it is empty."""
    try:
        vertices = HalfspaceIntersection(np.column_stack([A, -b]), inside).intersections
    except QhullError:
        return np.zeros((0, 3))
    vertices = vertices[np.isfinite(vertices).all(axis=1)]
    return np.unique(np.round(vertices, 9), axis=0)
