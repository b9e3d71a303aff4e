"""Canonical scans: the same triangles in the same order whatever the order of the file.

Corners are put on a grid of a micrometre and numbered by their coordinates, triangles by their
corners, so that all results, sums included, do not depend on the file's order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.scan.compiling import compiled
from climbplan.scan.raw import RawScan, select_triangles

GRID = 1e-6  # [m] corners closer than this are one
MAX_TRIANGLES = 400_000  # larger meshes are decimated
_MAX_CELLS = 2**20  # along the longest side, so that the number of a cell has 63 bits
_MIN_AREA = 1e-10  # [m^2]
_NUM_NEIGHBOURS = 12  # by whose distance outliers are found
_OUTLIER_RATIO = 4.0  # over the median distance of neighbours


def clean_mesh(raw: RawScan) -> RawScan:
    """Return triangles with an area, each once, consistently wound, at most `MAX_TRIANGLES`."""
    # The order of corners is that of coordinates in either case
    raw = merge_corners(raw) if len(raw.triangles) <= MAX_TRIANGLES else decimate(raw)
    is_flipped = _find_flipped(raw)
    count = int(is_flipped.sum())
    if count:
        triangles = np.where(is_flipped[:, None], raw.triangles[:, ::-1], raw.triangles)
        noun = "triangle" if count == 1 else "triangles"
        raw = replace(raw, triangles=triangles).add_notes(
            f"{count} {noun} turned round, against most of the surface they belong to"
        )
        raw = merge_corners(raw)
    count = _count_open_edges(raw.triangles)
    noun = "open edge" if count == 1 else "open edges"
    return raw.add_notes(f"{count} {noun} (borders and holes)") if count else raw


def merge_corners(raw: RawScan) -> RawScan:
    """Return the same surface with corners merged, and empty and repeated triangles left out."""
    keys = np.round(raw.vertices / GRID).astype(np.int64)
    distinct, number = find_unique_rows(keys)
    triangles = number[raw.triangles]
    vertices = np.asarray(distinct * GRID, np.float64)
    corners = vertices[triangles]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area = np.linalg.norm(doubled, axis=1) > 2 * _MIN_AREA
    triangles, label = triangles[has_area], raw.label[has_area]
    # The smallest corner first, then in order; winding stays
    first = triangles.argmin(axis=1)
    rows = np.arange(len(triangles))[:, None]
    triangles = triangles[rows, (first[:, None] + np.arange(3)) % 3]
    order = np.lexsort((label, triangles[:, 2], triangles[:, 1], triangles[:, 0]))
    triangles, label = triangles[order], label[order]
    is_repeated = np.zeros(len(triangles), bool)
    is_repeated[1:] = (triangles[1:] == triangles[:-1]).all(axis=1)
    notes = []
    if not has_area.all():
        notes.append(f"{int((~has_area).sum())} triangles without an area left out")
    if is_repeated.any():
        notes.append(f"{int(is_repeated.sum())} repeated triangles left out")
    clean = replace(raw, vertices=vertices, triangles=triangles, label=label, normals=None)
    return select_triangles(clean, ~is_repeated).add_notes(*notes)


def find_open_edges(triangles: IntArray) -> BoolArray:
    """Return (T, 3) whether the surface ends at each edge (corner k to k + 1).

    An edge at which closed bodies touch has an even number of triangles, and is not open.
    """
    if not len(triangles):
        return np.zeros((0, 3), bool)
    _, number, uses = np.unique(_number_edges(triangles), return_inverse=True, return_counts=True)
    return np.asarray(uses[number.reshape(-1, 3)] % 2 == 1)


def _count_open_edges(triangles: IntArray) -> int:
    """Return the number of distinct open edges."""
    return len(np.unique(_number_edges(triangles)[find_open_edges(triangles).ravel()]))


def _number_edges(triangles: IntArray) -> IntArray:
    """Return a number for each edge (3 T,) (corner k to k + 1), the same in both directions."""
    if not len(triangles):
        return np.zeros(0, np.int64)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    flat = edges.reshape(-1, 2)
    return np.asarray(flat[:, 0] * (int(triangles.max()) + 1) + flat[:, 1])


def find_unique_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct rows of (R, 3) in lexicographic order, and (R,) the number of each row.

    It is `np.unique` with `axis=0`, but sorts columns one after another instead of whole rows.
    """
    order = np.lexsort(rows.T[::-1])
    in_order = rows[order]
    is_first = np.ones(len(rows), bool)
    is_first[1:] = (in_order[1:] != in_order[:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(is_first) - 1
    return in_order[is_first], number


def find_neighbours(triangles: IntArray) -> IntArray:
    """Return the triangle across each edge (T, 3) (corner k to k + 1).

    -1 unless there is exactly one.
    """
    count = len(triangles)
    if not count:
        return np.zeros((0, 3), np.int64)
    key = _number_edges(triangles)
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    is_new = np.append(True, sorted_key[1:] != sorted_key[:-1])
    group = np.cumsum(is_new) - 1
    pairs = np.bincount(group) == 2
    starts = np.flatnonzero(is_new)[pairs]
    neighbour = np.full(3 * count, -1, np.int64)
    first, second = order[starts], order[starts + 1]
    neighbour[first], neighbour[second] = second // 3, first // 3
    return neighbour.reshape(count, 3)


def find_components(triangles: IntArray) -> IntArray:
    """Return the number of the connected surface that each triangle belongs to, (T,)."""
    across = find_neighbours(triangles)
    triangle, side = np.nonzero(across >= 0)
    graph = sparse.coo_matrix(
        (np.ones(len(triangle), np.int8), (triangle, across[triangle, side])),
        shape=(len(triangles),) * 2,
    )
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def compute_areas(raw: RawScan) -> Array:
    """Return the areas of the triangles (T,) [m^2]."""
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(doubled, axis=1) / 2)


def _find_flipped(raw: RawScan) -> np.ndarray:
    """Return the triangles (T,) to flip, so that each surface faces as most of its area does."""
    triangles = raw.triangles
    across = find_neighbours(triangles)
    side = orient_windings(
        triangles, across
    )  # 0 or 1: relative to the first triangle of its surface
    surface = find_components(triangles)
    area = compute_areas(raw)
    total = np.bincount(surface, weights=area)
    flipped_area = np.bincount(surface, weights=area * side)
    is_mostly_flipped = flipped_area > total / 2
    return np.asarray(side.astype(bool) != is_mostly_flipped[surface])


@compiled
def orient_windings(triangles: IntArray, across: IntArray) -> IntArray:
    """Return whether each triangle is wound against the first of its surface, breadth first."""
    count = len(triangles)
    side = np.full(count, -1, np.int64)
    queue = np.empty(count, np.int64)
    for seed in range(count):
        if side[seed] >= 0:
            continue
        side[seed] = 0
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            t = queue[head]
            head += 1
            for k in range(3):
                u = across[t, k]
                if u < 0 or side[u] >= 0:
                    continue
                a, b = triangles[t, k], triangles[t, (k + 1) % 3]
                same = False  # an edge run through in the same direction by both
                for j in range(3):
                    if triangles[u, j] == a and triangles[u, (j + 1) % 3] == b:
                        same = True
                side[u] = 1 - side[t] if same else side[t]
                queue[tail] = u
                tail += 1
    return side


def decimate(raw: RawScan) -> RawScan:
    """Return a surface of at most `MAX_TRIANGLES`, with a note on how far its corners moved.

    Corners in one cell of a cubic grid become their mean (vertex clustering, Rossignac and Borrel
    1993); triangles with two corners in one cell vanish. Cells grow until there are few enough.
    Sums
    are of whole micrometres, which are exact in any order of the file.
    """
    lower = raw.vertices.min(axis=0)
    extent = float(np.ptp(raw.vertices, axis=0).max())
    # Two triangles a cell of a flat surface
    cell = max(
        np.sqrt(4.0 * float(compute_areas(raw).sum()) / MAX_TRIANGLES), extent / _MAX_CELLS, GRID
    )
    while True:
        cell = float(f"{cell:.3g}")  # whatever the order in which areas were added
        cells = np.floor((raw.vertices - lower) / cell).astype(np.int64)
        key = (cells[:, 0] * 2 * _MAX_CELLS + cells[:, 1]) * 2 * _MAX_CELLS + cells[:, 2]
        del cells
        _, number = np.unique(key, return_inverse=True)
        del key
        count = np.bincount(number)
        means = np.empty((len(count), 3))
        squared_distance = np.zeros(len(number))  # [m^2] by which each corner moves
        for axis, column in enumerate(raw.vertices.T):
            sums = np.bincount(number, weights=np.round(column / GRID))
            means[:, axis] = GRID * sums / count
            squared_distance += (column - means[number, axis]) ** 2
        thin = merge_corners(
            replace(raw, vertices=means, triangles=number[raw.triangles], notes=())
        )
        if len(thin.triangles) <= MAX_TRIANGLES:
            break
        cell *= max(1.1, np.sqrt(len(thin.triangles) / MAX_TRIANGLES))
    return replace(thin, notes=raw.notes).add_notes(
        f"{len(raw.triangles)} triangles thinned to {len(thin.triangles)}, at most {MAX_TRIANGLES} "
        f"are used; corners moved by up to {1e3 * np.sqrt(squared_distance.max()):.1f} mm: `crop` "
        "keeps the details of a part"
    )


def remove_outliers(cloud: RawScan) -> RawScan:
    """Return a cloud without repeated points and those far from all others."""
    keys = np.round(cloud.vertices / GRID).astype(np.int64)
    number = find_unique_rows(keys)[1]
    first = np.unique(number, return_index=True)[1]
    points = cloud.vertices[first]
    notes = []
    if len(first) < len(keys):
        notes.append(f"{len(keys) - len(first)} repeated points left out")
    keep = np.ones(len(points), bool)
    if len(points) > _NUM_NEIGHBOURS:
        distance = cKDTree(points).query(points, _NUM_NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
        keep = distance <= _OUTLIER_RATIO * np.median(distance)
    if not keep.all():
        notes.append(f"{int((~keep).sum())} outliers left out, far from all other points")
    normals = None if cloud.normals is None else cloud.normals[first][keep]
    return replace(cloud, vertices=points[keep], normals=normals).add_notes(*notes)
