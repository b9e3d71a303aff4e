"""Upper bounds of a scanned surface on a grid, for swings that have to clear it.

Each cell has the height of the highest part of the surface in it or in a cell beside it, so that
the cell of any point bounds the surface within one cell of that point. What hangs over the ground
counts as ground.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.terrain.raw_surface import RawSurface

NOTHING = -1e30  # [m] height of cells without a surface
_CELL = 0.01  # [m]
_MAX_CELLS = 500_000
_CHUNK = 2_000_000  # cells under triangles at a time


class HeightGrid(NamedTuple):
    """Heights of square cells as compiled functions take them; no cells: there is no scan."""

    origin: Array  # (2,) lower corner [m]
    cell: float  # width of a cell [m]
    height: Array  # (X, Y) upper bounds [m], `NOTHING` without a surface


def build_empty_grid() -> HeightGrid:
    """Return a grid without cells."""
    return HeightGrid(np.zeros(2), 1.0, np.zeros((0, 0)))


def build_height_grid(scan: RawSurface) -> HeightGrid:
    """Return upper bounds of the heights of a scan."""
    corners = scan.corners
    low = corners.min(axis=(0, 1))[:2]
    extent = corners.max(axis=(0, 1))[:2] - low
    cell = max(_CELL, float(np.sqrt(np.prod(extent + _CELL) / _MAX_CELLS)))
    origin = low - 2 * cell
    shape = (np.ceil(extent / cell) + 4).astype(int)
    height = np.full(tuple(shape), NOTHING)
    first = np.floor((corners.min(axis=1)[:, :2] - origin) / cell).astype(int)
    last = np.floor((corners.max(axis=1)[:, :2] - origin) / cell).astype(int)
    count = (last - first + 1).prod(axis=1)
    group = np.cumsum(count) // _CHUNK
    for number in np.unique(group):
        _raise_cells(height, np.flatnonzero(group == number), corners, (first, last), origin, cell)
    return HeightGrid(origin, cell, _dilate(height))


def _raise_cells(
    height: Array,
    triangles: IntArray,
    corners: Array,
    ends: tuple[IntArray, IntArray],
    origin: Array,
    cell: float,
) -> None:
    """Raise the cells that some triangles touch to an upper bound of their heights, in place."""
    first, last = ends[0][triangles], ends[1][triangles]
    size = last - first + 1
    count = size.prod(axis=1)
    owner = np.repeat(np.arange(len(triangles)), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    index = first[owner] + np.column_stack(np.divmod(within, size[owner, 1]))
    middle = origin + (index + 0.5) * cell
    places = corners[triangles]
    side = np.roll(places, -1, axis=1) - places  # (T, 3, 3)
    area = side[:, 0, 1] * side[:, 2, 0] - side[:, 0, 0] * side[:, 2, 1]
    is_upright = np.abs(area) < 1e-12
    turn = np.where(area < 0, -1.0, 1.0)[:, None]
    outward = turn[..., None] * np.stack([side[..., 1], -side[..., 0]], axis=-1)
    offset = middle[:, None] - places[owner, :, :2]
    distance = (outward[owner] * offset).sum(axis=-1)
    half_width = 0.5 * cell * np.abs(outward).sum(axis=-1)
    touches = (distance <= half_width[owner] + 1e-12).all(axis=1) | is_upright[owner]
    normal = np.cross(side[:, 0], -side[:, 2])
    rise = -normal[:, :2] / np.where(is_upright, 1.0, normal[:, 2])[:, None]
    plane = places[:, 0, 2][owner] + (rise[owner] * offset[:, 0]).sum(axis=1)
    plane += 0.5 * cell * np.abs(rise).sum(axis=1)[owner]
    highest = places[..., 2].max(axis=1)[owner]
    bound = np.where(is_upright[owner], highest, np.minimum(plane, highest))
    np.maximum.at(height, tuple(index[touches].T), bound[touches])


def _dilate(height: Array) -> Array:
    """Return the maximum over each cell and the eight around it."""
    padded = np.pad(height, 1, constant_values=NOTHING)
    x, y = height.shape
    shifted = [padded[i : i + x, j : j + y] for i in range(3) for j in range(3)]
    return np.asarray(np.maximum.reduce(shifted))


def find_highest_near(grid: HeightGrid, xy: Array, radius: float) -> Array:
    """Return upper bounds (...) of the surface within a radius [m] of points (..., 2)."""
    highest = np.full(xy.shape[:-1], NOTHING)
    if not grid.height.size:
        return highest
    reach = int(np.ceil(radius / grid.cell))
    cell = np.floor((xy - grid.origin) / grid.cell).astype(int)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            if np.hypot(i, j) * grid.cell <= radius + grid.cell:
                index = cell + np.array([i, j])
                inside = ((index >= 0) & (index < grid.height.shape)).all(axis=-1)
                x, y = np.moveaxis(np.where(inside[..., None], index, 0), -1, 0)
                highest = np.maximum(highest, np.where(inside, grid.height[x, y], NOTHING))
    return highest
