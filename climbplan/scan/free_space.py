"""Convex free space for the body along its way through a scan.

A polytope is inflated about what the body sweeps on a piece of the way: from the nearest triangle
on, a plane across the widest gap between sweep and triangle cuts away what is beyond it,
until no triangle is left inside. The planes touch the triangles, not the sweep. (Compare R. Deits
and R. Tedrake, 2014; S. Liu et al., 2017.)
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import HalfspaceIntersection, QhullError

from climbplan.arrays import Array
from climbplan.scan.distances import segment_distances

_LONGEST = 0.4  # [m] of a piece of the way
_BESIDE = 0.6  # [m] that a region reaches beyond the sweep at most
_INWARD = 1e-6  # [m] by which regions stay off triangles


@dataclass(frozen=True)
class FreeSpace:
    """A convex piece of free space about a piece of the body's way."""

    vertices: Array  # (V, 3) [m]
    least_room: float  # [m] from the sweep of the body to the nearest triangle, 0 where they meet
    place: Array  # (3,) middle of the piece of the way


def pieces_of(guide: Array) -> Array:
    """Ends (K, 2, 3) of pieces of a polyline (P, 3), none longer than a body."""
    pieces = []
    for start, end in itertools.pairwise(guide):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _LONGEST - 1e-9)))
        points = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
        pieces += list(itertools.pairwise(points))
    return np.array(pieces).reshape(-1, 2, 3)


def free_space(ends: Array, hull: Array, corners: Array) -> FreeSpace:
    """Free space about the sweep of a body's hull (V, 3) along a piece of its way (2, 3).

    corners: (T, 3, 3) triangles. Where the sweep meets a triangle no plane is put between them.
    """
    sweep = np.concatenate([end + hull for end in ends])
    low, high = sweep.min(axis=0) - _BESIDE, sweep.max(axis=0) + _BESIDE
    A = [np.eye(3), -np.eye(3)]
    b = [high, -low]
    near = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(axis=1)
    left = corners[near]
    starts = np.broadcast_to(ends[0], (len(left), 3))
    stops = np.broadcast_to(ends[1], (len(left), 3))
    away = np.array(
        [
            segment_distances(p[None], q[None], t[None], 1e3)[0]
            for p, q, t in zip(starts, stops, left, strict=True)
        ]
    )
    order = np.argsort(away, kind="stable")
    left = left[order]
    least = np.inf
    while len(left):
        normal, gap = _parting(sweep, left[0])
        least = min(least, gap)
        if gap <= 0:
            left = left[1:]
            continue
        offset = float((left[0] @ normal).min()) - _INWARD
        A.append(normal[None])
        b.append(np.array([offset]))
        left = left[(left @ normal).min(axis=1) < offset]
    vertices = _vertices(np.concatenate(A), np.concatenate(b), ends.mean(axis=0))
    return FreeSpace(vertices, least, ends.mean(axis=0))


def _parting(sweep: Array, triangle: Array) -> tuple[Array, float]:
    """Unit normal from a hull of points to a triangle across their gap, and its width [m]."""
    differences = (triangle[None] - sweep[:, None]).reshape(-1, 3)
    system = np.vstack([differences.T, np.ones(len(differences))])
    weights = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))[0]
    nearest = weights @ differences
    length = float(np.linalg.norm(nearest))
    if length < 1e-9:
        return np.zeros(3), 0.0
    normal = nearest / length
    return normal, float((triangle @ normal).min() - (sweep @ normal).max())


def _vertices(A: Array, b: Array, inside: Array) -> Array:
    try:
        found = HalfspaceIntersection(np.column_stack([A, -b]), inside).intersections
    except QhullError:
        return np.zeros((0, 3))
    found = found[np.isfinite(found).all(axis=1)]
    return np.unique(np.round(found, 9), axis=0)
