"""Planar segmentation of a surface by region growing.

A patch grows from a seed over shared edges as long as all corners lie within a tolerance of its
plane and the (smoothed) surface faces as it does. Then the plane is fitted to the patch, and the
patch grows again from its seed, until it grows no more. Seeds lie where no patch is yet, but
patches may overlap: on curved surfaces they are round, and as wide as curvature and tolerance
allow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.scan.cleaning import compute_areas, find_neighbours
from climbplan.scan.compiling import compiled
from climbplan.scan.raw import RawScan

_MIN_FACING = np.cos(np.deg2rad(35.0))  # of the surface of a patch to its normal
_SHARP_EDGE = np.cos(np.deg2rad(50.0))  # below which normals are not smoothed across an edge
_NUM_SMOOTHINGS = 2
_MAX_FITS = 8  # of the plane of a patch


class FlatPatches(NamedTuple):
    """P flat patches of a surface of T triangles."""

    owner: IntArray  # (T,) the first patch of each triangle
    normal: Array  # (P, 3) unit
    offset: Array  # (P,) normal . x on the plane [m]
    starts: IntArray  # (P + 1,) of the patches in `members`
    members: IntArray  # triangles of all patches

    def of(self, patch: int) -> IntArray:
        """Return the triangles of a patch."""
        return self.members[self.starts[patch] : self.starts[patch + 1]]


def segment_planar_patches(raw: RawScan, flatness: float) -> FlatPatches:
    """Segment a surface into planar patches, each triangle in at least one.

    Seeds are taken by the size of their triangles, then where the surface is flattest.

    Args:
        raw: The surface.
        flatness: Distance of the triangles of a patch from its plane [m].
    """
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = compute_areas(raw)
    normals = doubled / (2 * area)[:, None]
    neighbour = find_neighbours(raw.triangles)
    smooth = normals
    for _ in range(_NUM_SMOOTHINGS):
        smooth = _smooth_normals(smooth, normals, area, neighbour)
    bending = np.where(neighbour >= 0, 1 - np.einsum("ij,ikj->ik", smooth, smooth[neighbour]), 0.0)
    size = np.round(np.log2(area / area.max()))  # triangles of a mesh are about as large
    order = np.lexsort((np.arange(len(area)), np.round(bending.sum(axis=1), 6), -size))
    return FlatPatches(
        *grow_patches(corners, smooth, area, neighbour, raw.label, order.astype(np.int64), flatness)
    )


def _smooth_normals(smooth: Array, normals: Array, area: Array, neighbours: IntArray) -> Array:
    """Return normals averaged by area with those across edges that are not sharp."""
    total = area[:, None] * smooth
    for k in range(3):
        neighbour = neighbours[:, k]
        is_smooth = (neighbour >= 0) & (
            np.einsum("ij,ij->i", normals, normals[neighbour]) > _SHARP_EDGE
        )
        total += np.where(is_smooth[:, None], area[neighbour, None] * smooth[neighbour], 0.0)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


@compiled
def _flood_fill(
    seed: int,
    normal: Array,
    offset: float,
    corners: Array,
    smooth: Array,
    across: IntArray,
    label: IntArray,
    mark: IntArray,
    stamp: int,
    flatness: float,
    queue: IntArray,
) -> int:
    """Fill `queue` with the triangles that a plane takes from a seed; return their number.

    stamp: number of this search, with which `mark` (T,) marks visited triangles.
    """
    queue[0] = seed
    mark[seed] = stamp
    head, tail = 0, 1
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(3):
            u = across[t, k]
            if u < 0 or mark[u] == stamp or label[u] != label[seed]:
                continue
            facing = smooth[u, 0] * normal[0] + smooth[u, 1] * normal[1] + smooth[u, 2] * normal[2]
            if facing < _MIN_FACING:
                continue
            within = True
            for c in range(3):
                height = -offset
                for j in range(3):
                    height += corners[u, c, j] * normal[j]
                if abs(height) > flatness:
                    within = False
            if within:
                mark[u] = stamp
                queue[tail] = u
                tail += 1
    return tail


@compiled
def _fit_plane(queue: IntArray, count: int, corners: Array, area: Array, before: Array) -> Array:
    """Return normal and offset (4,) of the best-fitting plane, midway between the farthest corners.

    It is the principal component with the smallest variance, weighed by area, on the side of
    `before`.
    """
    mean = np.zeros(3)
    total = 0.0
    for i in range(count):
        t = queue[i]
        total += area[t]
        for c in range(3):
            for j in range(3):
                mean[j] += area[t] * corners[t, c, j] / 3
    mean /= total
    spread = np.zeros((3, 3))
    for i in range(count):
        t = queue[i]
        for c in range(3):
            for j in range(3):
                for k in range(3):
                    spread[j, k] += (
                        area[t] * (corners[t, c, j] - mean[j]) * (corners[t, c, k] - mean[k])
                    )
    _, vectors = np.linalg.eigh(spread)
    out = np.empty(4)
    side = vectors[0, 0] * before[0] + vectors[1, 0] * before[1] + vectors[2, 0] * before[2]
    for j in range(3):
        out[j] = vectors[j, 0] if side >= 0 else -vectors[j, 0]
    low, high = np.inf, -np.inf
    for i in range(count):
        t = queue[i]
        for c in range(3):
            height = (
                corners[t, c, 0] * out[0] + corners[t, c, 1] * out[1] + corners[t, c, 2] * out[2]
            )
            low = min(low, height)
            high = max(high, height)
    out[3] = (low + high) / 2
    return out


@compiled
def _build_seed_plane(triangle: Array) -> Array:
    """Return normal and offset (4,) of the plane of a triangle (3, 3)."""
    plane = np.empty(4)
    edge = triangle[1] - triangle[0]
    second_edge = triangle[2] - triangle[0]
    plane[0] = edge[1] * second_edge[2] - edge[2] * second_edge[1]
    plane[1] = edge[2] * second_edge[0] - edge[0] * second_edge[2]
    plane[2] = edge[0] * second_edge[1] - edge[1] * second_edge[0]
    length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    for j in range(3):
        plane[j] /= length
    plane[3] = plane[0] * triangle[0, 0] + plane[1] * triangle[0, 1] + plane[2] * triangle[0, 2]
    return plane


@compiled
def _measure_distance(triangle: Array, plane: Array) -> float:
    """Return the largest distance of the corners of a triangle (3, 3) from a plane (4,) [m]."""
    distance = 0.0
    for c in range(3):
        height = -plane[3]
        for j in range(3):
            height += triangle[c, j] * plane[j]
        distance = max(distance, abs(height))
    return distance


@compiled
def grow_patches(
    corners: Array,
    smooth: Array,
    area: Array,
    across: IntArray,
    label: IntArray,
    order: IntArray,
    flatness: float,
) -> tuple[IntArray, Array, Array, IntArray, IntArray]:
    """Return the fields of `FlatPatches`, from seeds in the given order.

    Args:
        corners: (T, 3, 3) [m].
        smooth: Smoothed unit normals (T, 3).
        area: (T,) [m^2].
        across: Neighbouring triangle of each edge (T, 3), -1 for none.
        label: Material (T,): patches have one.
        order: Triangles (T,) in the order of seeds.
        flatness: Distance from the plane [m].
    """
    count = len(corners)
    owner = np.full(count, -1, np.int64)
    mark = np.full(count, -1, np.int64)
    queue = np.empty(count, np.int64)
    best = np.empty(count, np.int64)
    planes = np.empty((count, 4))
    starts = np.zeros(count + 1, np.int64)
    members = np.empty(4 * count, np.int64)
    num_members = 0
    num_patches = 0
    stamp = int(np.int64(0))  # a literal would be compiled again
    for s in range(count):
        seed = order[s]
        if owner[seed] >= 0:
            continue
        plane = _build_seed_plane(corners[seed])
        max_area, best_count = -1.0, 0
        for attempt in range(_MAX_FITS):
            size = _flood_fill(
                seed,
                plane[:3],
                plane[3],
                corners,
                smooth,
                across,
                label,
                mark,
                stamp,
                flatness,
                queue,
            )
            stamp += 1
            total = 0.0
            for i in range(size):
                total += area[queue[i]]
            # The seed itself may have left the plane
            if attempt > 0 and _measure_distance(corners[seed], plane) > flatness:
                break
            if total <= max_area * (1 + 1e-9):
                break
            max_area, best_count = total, size
            for i in range(size):
                best[i] = queue[i]
            for j in range(4):
                planes[num_patches, j] = plane[j]
            if size == 1 and attempt > 0:
                break
            plane = _fit_plane(queue, size, corners, area, plane)
        if num_members + best_count > len(members):
            members = np.concatenate((members, np.empty(len(members) + count, np.int64)))
        for i in range(best_count):
            if owner[best[i]] < 0:
                owner[best[i]] = num_patches
            members[num_members + i] = best[i]
        num_members += best_count
        num_patches += 1
        starts[num_patches] = num_members
    normal, offset = planes[:num_patches, :3].copy(), planes[:num_patches, 3].copy()
    return owner, normal, offset, starts[: num_patches + 1].copy(), members[:num_members].copy()
