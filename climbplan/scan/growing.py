"""Connected triangles that one plane passes within a tolerance: the flat patches of a surface.

A patch grows from a seed over shared edges as long as all corners lie within the tolerance of its
plane and the (smoothed) surface faces as it does. Then the plane is fitted anew to what was found,
and the patch grows again from its seed, until it grows no more. Seeds lie where no patch is yet,
but patches may overlap: on curved surfaces they are as wide as curvature and tolerance allow, and
round.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.scan.cleaning import areas, neighbours
from climbplan.scan.compiling import compiled
from climbplan.scan.raw import RawScan

_TURN = np.cos(np.deg2rad(35.0))  # that the surface of a patch may be off its normal
_OVER_EDGE = np.cos(np.deg2rad(50.0))  # beyond which normals are not smoothed across an edge
_SMOOTHINGS = 2
_FITS = 8  # times that a plane is fitted anew


class Patches(NamedTuple):
    """Flat patches: P of them."""

    owner: IntArray  # (T,) the first patch of each triangle
    normal: Array  # (P, 3) unit
    offset: Array  # (P,) normal . x on the plane [m]
    starts: IntArray  # (P + 1,) of the patches in `members`
    members: IntArray  # triangles of all patches

    def of(self, patch: int) -> IntArray:
        """The triangles of a patch."""
        return self.members[self.starts[patch] : self.starts[patch + 1]]


def grown(raw: RawScan, flatness: float) -> Patches:
    """Patches whose triangles lie within `flatness` [m] of their planes; each triangle is in one.

    Seeds are taken by the size of their triangles, then where the surface is flattest.
    """
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = areas(raw)
    normals = doubled / (2 * area)[:, None]
    across = neighbours(raw.triangles)
    smooth = normals
    for _ in range(_SMOOTHINGS):
        smooth = _smoothed(smooth, normals, area, across)
    bend = np.where(across >= 0, 1 - np.einsum("ij,ikj->ik", smooth, smooth[across]), 0.0)
    size = np.round(np.log2(area / area.max()))  # triangles of a mesh are about as large
    order = np.lexsort((np.arange(len(area)), np.round(bend.sum(axis=1), 6), -size))
    return Patches(
        *grow_patches(corners, smooth, area, across, raw.label, order.astype(np.int64), flatness)
    )


def _smoothed(smooth: Array, normals: Array, area: Array, across: IntArray) -> Array:
    """Normals averaged with those across edges that are not sharp, by area."""
    total = area[:, None] * smooth
    for k in range(3):
        other = across[:, k]
        alike = (other >= 0) & (np.einsum("ij,ij->i", normals, normals[other]) > _OVER_EDGE)
        total += np.where(alike[:, None], area[other, None] * smooth[other], 0.0)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


@compiled
def _reach(
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
    """Fill `queue` with the triangles that a plane takes from a seed; their number."""
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
            if facing < _TURN:
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
def _fit(queue: IntArray, count: int, corners: Array, area: Array, before: Array) -> Array:
    """Normal and offset (4,) of the plane that fits triangles best, midway between the farthest."""
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
def grow_patches(
    corners: Array,
    smooth: Array,
    area: Array,
    across: IntArray,
    label: IntArray,
    order: IntArray,
    flatness: float,
) -> tuple[IntArray, Array, Array, IntArray, IntArray]:
    count = len(corners)
    taken = np.full(count, -1, np.int64)
    mark = np.full(count, -1, np.int64)
    queue = np.empty(count, np.int64)
    best = np.empty(count, np.int64)
    planes = np.empty((count, 4))
    starts = np.zeros(count + 1, np.int64)
    members = np.empty(4 * count, np.int64)
    used = 0
    patches = 0
    stamp = int(np.int64(0))  # as a literal it would be compiled for anew
    for s in range(count):
        seed = order[s]
        if taken[seed] >= 0:
            continue
        plane = np.empty(4)
        edge = corners[seed, 1] - corners[seed, 0]
        other = corners[seed, 2] - corners[seed, 0]
        plane[0] = edge[1] * other[2] - edge[2] * other[1]
        plane[1] = edge[2] * other[0] - edge[0] * other[2]
        plane[2] = edge[0] * other[1] - edge[1] * other[0]
        length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
        for j in range(3):
            plane[j] /= length
        plane[3] = (
            plane[0] * corners[seed, 0, 0]
            + plane[1] * corners[seed, 0, 1]
            + plane[2] * corners[seed, 0, 2]
        )
        most, best_count = -1.0, 0
        for attempt in range(_FITS):
            found = _reach(
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
            for i in range(found):
                total += area[queue[i]]
            if attempt > 0:
                # The seed itself may have left the plane
                off = 0.0
                for c in range(3):
                    height = -plane[3]
                    for j in range(3):
                        height += corners[seed, c, j] * plane[j]
                    off = max(off, abs(height))
                if off > flatness:
                    break
            if total <= most * (1 + 1e-9):
                break
            most, best_count = total, found
            for i in range(found):
                best[i] = queue[i]
            for j in range(4):
                planes[patches, j] = plane[j]
            if found == 1 and attempt > 0:
                break
            plane = _fit(queue, found, corners, area, plane)
        if used + best_count > len(members):
            members = np.concatenate((members, np.empty(len(members) + count, np.int64)))
        for i in range(best_count):
            if taken[best[i]] < 0:
                taken[best[i]] = patches
            members[used + i] = best[i]
        used += best_count
        patches += 1
        starts[patches] = used
    normal, offset = planes[:patches, :3].copy(), planes[:patches, 3].copy()
    return taken, normal, offset, starts[: patches + 1].copy(), members[:used].copy()
