"""Scans put in order: the same triangles in the same order whatever the file's was.

Corners are put on a grid of a micrometre and numbered by their coordinates, triangles by their
corners, so that everything made of them, sums included, does not depend on the file's order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.scan.compiling import compiled
from climbplan.scan.raw import RawScan, chosen

GRID = 1e-6  # [m] corners closer than this are one
MAX_TRIANGLES = 400_000  # more are thinned
_MAX_CELLS = 2**20  # along the longest side, so that the number of a cell has 63 bits
_LEAST_AREA = 1e-10  # [m^2]
_NEIGHBOURS = 12  # of a point that may be an outlier
_FAR = 4.0  # times the usual distance of neighbours


def cleaned(raw: RawScan) -> RawScan:
    """Triangles with an area, each once, wound like their neighbours, at most `MAX_TRIANGLES`."""
    # The order of corners is that of coordinates in either case
    raw = ordered(raw) if len(raw.triangles) <= MAX_TRIANGLES else decimate(raw)
    turned = _wound_alike(raw)
    count = int(turned.sum())
    if count:
        triangles = np.where(turned[:, None], raw.triangles[:, ::-1], raw.triangles)
        noun = "triangle" if count == 1 else "triangles"
        raw = replace(raw, triangles=triangles).noted(
            f"{count} {noun} turned round, against most of the surface they belong to"
        )
        raw = ordered(raw)
    count = _num_open_edges(raw.triangles)
    noun = "open edge" if count == 1 else "open edges"
    return raw.noted(f"{count} {noun} (borders and holes)") if count else raw


def ordered(raw: RawScan) -> RawScan:
    """The same surface with corners merged, and empty and repeated triangles left out."""
    keys = np.round(raw.vertices / GRID).astype(np.int64)
    distinct, number = unique_rows(keys)
    triangles = number[raw.triangles]
    vertices = np.asarray(distinct * GRID, np.float64)
    corners = vertices[triangles]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sound = np.linalg.norm(doubled, axis=1) > 2 * _LEAST_AREA
    triangles, label = triangles[sound], raw.label[sound]
    # The smallest corner first, then in order; winding stays
    first = triangles.argmin(axis=1)
    rows = np.arange(len(triangles))[:, None]
    triangles = triangles[rows, (first[:, None] + np.arange(3)) % 3]
    order = np.lexsort((label, triangles[:, 2], triangles[:, 1], triangles[:, 0]))
    triangles, label = triangles[order], label[order]
    again = np.zeros(len(triangles), bool)
    again[1:] = (triangles[1:] == triangles[:-1]).all(axis=1)
    notes = []
    if not sound.all():
        notes.append(f"{int((~sound).sum())} triangles without an area left out")
    if again.any():
        notes.append(f"{int(again.sum())} repeated triangles left out")
    clean = replace(raw, vertices=vertices, triangles=triangles, label=label, normals=None)
    return chosen(clean, ~again).noted(*notes)


def open_edges(triangles: IntArray) -> BoolArray:
    """Return (T, 3) whether the surface ends at each edge (corner k to k + 1).

    An edge at which closed bodies touch has an even number of triangles, and is not open.
    """
    if not len(triangles):
        return np.zeros((0, 3), bool)
    _, number, uses = np.unique(_edge_keys(triangles), return_inverse=True, return_counts=True)
    return np.asarray(uses[number.reshape(-1, 3)] % 2 == 1)


def _num_open_edges(triangles: IntArray) -> int:
    return len(np.unique(_edge_keys(triangles)[open_edges(triangles).ravel()]))


def _edge_keys(triangles: IntArray) -> IntArray:
    """(3 T,) a number for each edge (corner k to k + 1), the same in both directions."""
    if not len(triangles):
        return np.zeros(0, np.int64)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    flat = edges.reshape(-1, 2)
    return np.asarray(flat[:, 0] * (int(triangles.max()) + 1) + flat[:, 1])


def unique_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct rows of (R, 3) in lexicographic order, and (R,) the number of each row.

    As `np.unique` with `axis=0`, in a fraction of its time and memory: columns are sorted one after
    another, where that compares whole rows.
    """
    order = np.lexsort(rows.T[::-1])
    in_order = rows[order]
    is_first = np.ones(len(rows), bool)
    is_first[1:] = (in_order[1:] != in_order[:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(is_first) - 1
    return in_order[is_first], number


def neighbours(triangles: IntArray) -> IntArray:
    """(T, 3) the triangle across each edge (corner k to k + 1), -1 where there is not just one."""
    count = len(triangles)
    if not count:
        return np.zeros((0, 3), np.int64)
    key = _edge_keys(triangles)
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    new = np.append(True, sorted_key[1:] != sorted_key[:-1])
    group = np.cumsum(new) - 1
    pairs = np.bincount(group) == 2
    starts = np.flatnonzero(new)[pairs]
    across = np.full(3 * count, -1, np.int64)
    one, other = order[starts], order[starts + 1]
    across[one], across[other] = other // 3, one // 3
    return across.reshape(count, 3)


def components(triangles: IntArray) -> IntArray:
    """(T,) number of the connected surface that each triangle belongs to."""
    across = neighbours(triangles)
    own, side = np.nonzero(across >= 0)
    graph = sparse.coo_matrix(
        (np.ones(len(own), np.int8), (own, across[own, side])), shape=(len(triangles),) * 2
    )
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def areas(raw: RawScan) -> Array:
    """(T,) [m^2]."""
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(doubled, axis=1) / 2)


def _wound_alike(raw: RawScan) -> np.ndarray:
    """(T,) triangles to turn round, so that each surface faces as most of its area does."""
    triangles = raw.triangles
    across = neighbours(triangles)
    side = sides_of(triangles, across)  # 0 or 1: relative to the first triangle of its surface
    surface = components(triangles)
    area = areas(raw)
    total = np.bincount(surface, weights=area)
    other = np.bincount(surface, weights=area * side)
    most = other > total / 2
    return np.asarray(side.astype(bool) != most[surface])


@compiled
def sides_of(triangles: IntArray, across: IntArray) -> IntArray:
    """Whether each triangle is wound against the first of its surface, breadth first."""
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
    1993); triangles with two corners in one cell vanish. Cells are as wide as it takes. Sums are of
    whole micrometres, which are exact in any order of the file.
    """
    lower = raw.vertices.min(axis=0)
    extent = float(np.ptp(raw.vertices, axis=0).max())
    # Two triangles a cell of a flat surface
    cell = max(np.sqrt(4.0 * float(areas(raw).sum()) / MAX_TRIANGLES), extent / _MAX_CELLS, GRID)
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
        thin = ordered(replace(raw, vertices=means, triangles=number[raw.triangles], notes=()))
        if len(thin.triangles) <= MAX_TRIANGLES:
            break
        cell *= max(1.1, np.sqrt(len(thin.triangles) / MAX_TRIANGLES))
    return replace(thin, notes=raw.notes).noted(
        f"{len(raw.triangles)} triangles thinned to {len(thin.triangles)}, at most {MAX_TRIANGLES} "
        f"are used; corners moved by up to {1e3 * np.sqrt(squared_distance.max()):.1f} mm: `crop` "
        "keeps the details of a part"
    )


def without_outliers(cloud: RawScan) -> RawScan:
    """A cloud without repeated points and those far from all others."""
    keys = np.round(cloud.vertices / GRID).astype(np.int64)
    number = unique_rows(keys)[1]
    first = np.unique(number, return_index=True)[1]
    points = cloud.vertices[first]
    notes = []
    if len(first) < len(keys):
        notes.append(f"{len(keys) - len(first)} repeated points left out")
    keep = np.ones(len(points), bool)
    if len(points) > _NEIGHBOURS:
        away = cKDTree(points).query(points, _NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
        keep = away <= _FAR * np.median(away)
    if not keep.all():
        notes.append(f"{int((~keep).sum())} outliers left out, far from all other points")
    normals = None if cloud.normals is None else cloud.normals[first][keep]
    return replace(cloud, vertices=points[keep], normals=normals).noted(*notes)
