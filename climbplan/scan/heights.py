"""Height maps as triangles: GeoTIFF and PNG by Pillow, NPY, CSV."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.reading import ANY_ERROR, read_text, reading
from climbplan.scan.clouds import build_cloud, read_array
from climbplan.scan.raw import RawScan, ScanError, build_mesh, transform_to_world
from climbplan.schema.terrain.scan import ScanSpec

HEIGHTS = (".tif", ".tiff", ".png", ".csv")
_PIXEL_SCALE, _TIEPOINT, _NO_DATA = 33550, 33922, 42113  # tags of GeoTIFF
_MAX_HEIGHTS = 25_000_000  # in a file
_MAX_CSV_SIZE = 500_000_000  # [bytes]
MAX_USED_HEIGHTS = 500_000  # that become triangles; of more every second, third, ... is taken
_BAND = 256  # rows that are processed together


@dataclass(frozen=True)
class _Grid:
    """Heights in rows and columns, and their positions in the file's frame."""

    heights: Array  # (R, C), NaN where there is none
    x: Array  # (C,) [m]
    y: Array  # (R,) [m]
    origin: Array  # (3,) [m]
    height: float  # [m] of one unit of `heights`

    def points(self, rows: slice) -> Array:
        """Return points (R', C, 3) of some rows [m]."""
        x, y = np.broadcast_arrays(self.x, self.y[rows, None])
        return np.stack([x, y, self.height * self.heights[rows]], axis=-1) + self.origin

    def select(self, rows: slice, columns: slice) -> _Grid:
        """Return the grid of some rows and columns."""
        heights = self.heights[rows, columns]
        return _Grid(heights, self.x[columns], self.y[rows], self.origin, self.height)


def read_heights(path: Path, spec: ScanSpec) -> RawScan:
    """Read a height map as two triangles a cell, north up.

    In images x grows with columns and y against rows; in NPY and CSV y grows with rows. Cells
    without
    a number are holes.

    Raises:
        ScanError: The file is no height map.
    """
    suffix = path.suffix.lower()
    image = suffix in (".tif", ".tiff", ".png")
    cell, corner = spec.cell, None
    if image:
        heights, own_cell, corner = _read_image(path)
        cell = cell or own_cell
    else:
        heights = read_array(path) if suffix == ".npy" else _read_csv(path)
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ScanError(f"{path}: expected a table of heights, got shape {heights.shape}")
    if heights.size > _MAX_HEIGHTS:
        raise ScanError(f"{path}: {heights.size} heights, expected at most {_MAX_HEIGHTS}")
    if cell is None:
        raise ScanError(f"{path}: a height map without `cell`, expected the width of a cell [m]")
    if spec.origin is not None:
        origin = np.array(spec.origin)
    elif corner is not None:
        origin = corner
    else:
        origin = np.zeros(3)
    rows, columns = heights.shape
    row = np.arange(rows)
    y = (rows - 1 - row) * cell if image and corner is None else row * cell
    if corner is not None:
        y = -row * cell  # a tiepoint is the north-west corner
    x = np.asarray(np.arange(columns) * cell, float)
    grid = _Grid(heights, x, np.asarray(y, float), origin, spec.height)
    return _triangulate(path, grid, spec, image)


def _triangulate(path: Path, grid: _Grid, spec: ScanSpec, image: bool) -> RawScan:
    """Return the triangles of a grid, thinned to `MAX_USED_HEIGHTS`.

    Raises ScanError without any. image: whether y runs against the rows.
    """
    grid = _within_crop(grid, spec)
    every, size = (
        max(1, math.ceil(math.sqrt(grid.heights.size / MAX_USED_HEIGHTS))),
        grid.heights.shape,
    )
    if every > 1:
        grid = grid.select(slice(None, None, every), slice(None, None, every))
    heights = grid.heights
    rows, columns = heights.shape
    points = grid.points(slice(None))
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (number[i : rows - 1 + i, j : columns - 1 + j] for i, j in _CORNERS)
    triangles = np.concatenate(
        [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))]
    )
    if image:  # y runs against the rows
        triangles = triangles[:, ::-1]
    flat = points.reshape(-1, 3)
    triangles = triangles[np.isfinite(flat[triangles]).all(axis=(1, 2))]
    missing = int((~np.isfinite(heights)).sum())
    flat = np.where(np.isfinite(flat), flat, 0.0)
    raw = build_mesh(flat, triangles)
    if not len(triangles):
        raise ScanError(f"{path}: no four heights beside one another are numbers")
    if every > 1:
        raw = raw.add_notes(
            f"of {size[0]} x {size[1]} heights every {every}th row and column taken: `crop` keeps "
            "the details of a part"
        )
    return raw.add_notes(f"{missing} of {heights.size} heights missing") if missing else raw


_CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))


def _within_crop(grid: _Grid, spec: ScanSpec) -> _Grid:
    """Return the rows and columns that reach into `crop`, with a cell around them; else all."""
    if spec.crop is None:
        return grid
    lower, upper = np.array(spec.crop.lower), np.array(spec.crop.upper)
    rows, columns = grid.heights.shape
    used_rows, used_columns = np.zeros(rows, bool), np.zeros(columns, bool)
    for start in range(0, rows, _BAND):
        band = slice(start, min(start + _BAND, rows))
        points = transform_to_world(build_cloud(grid.points(band).reshape(-1, 3)), spec).vertices
        inside = ((points >= lower) & (points <= upper)).all(axis=1).reshape(-1, columns)
        used_rows[band] = inside.any(axis=1)
        used_columns |= inside.any(axis=0)
    if not used_rows.any():
        return grid
    return grid.select(_find_range(used_rows), _find_range(used_columns))


def _find_range(is_used: np.ndarray) -> slice:
    """Return the range of what is used, one wider at both ends."""
    first, last = np.flatnonzero(is_used)[[0, -1]]
    return slice(max(0, int(first) - 1), int(last) + 2)


def _read_csv(path: Path) -> Array:
    """Read a table of heights."""
    text = read_text(path, _MAX_CSV_SIZE, "a table of heights")
    with reading(path, "a table of heights", ScanError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files without data, which are refused later
        delimiter = next((d for d in ",;\t" if d in text), None)
        try:
            return np.genfromtxt(text.splitlines(), delimiter=delimiter, ndmin=2)
        except ValueError as error:  # its first line only says that there are errors
            raise ValueError(str(error).splitlines()[-1].strip()) from None


def _read_image(path: Path) -> tuple[Array, float | None, Array | None]:
    """Return heights, width of a cell and position of the first one.

    Width and position are None where the file does not say them.
    """
    from PIL import Image

    expected = "an image of heights"
    with reading(path, expected, ScanError, damage=ANY_ERROR), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of damaged tags, which are not needed
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(path) as image:
            if image.width * image.height > _MAX_HEIGHTS:
                size = image.width * image.height
                raise ScanError(f"{path}: {size} heights, expected at most {_MAX_HEIGHTS}")
            if image.mode in ("RGB", "RGBA", "P", "CMYK", "YCbCr"):
                raise ScanError(f"{path}: a picture in colours, expected one height a pixel")
            heights = np.asarray(image, float)
            tags = dict(getattr(image, "tag_v2", {}))
    try:
        nothing = float(str(tags[_NO_DATA]).strip("\0 "))
        heights = np.where(heights == nothing, np.nan, heights)
    except (KeyError, ValueError):
        pass
    if _PIXEL_SCALE not in tags:
        return heights, None, None
    across, along = _parse_numbers(path, "ModelPixelScale", tags[_PIXEL_SCALE], 2)
    if not (0 < across < np.inf and abs(across - along) < 1e-6 * across):
        raise ScanError(f"{path}: cells of {across:g} by {along:g}, expected square ones")
    if _TIEPOINT not in tags:
        return heights, across, None
    column, row, _, east, north = _parse_numbers(path, "ModelTiepoint", tags[_TIEPOINT], 5)
    return heights, across, np.array([east - column * across, north + row * across, 0.0])


def _parse_numbers(path: Path, name: str, value: Any, count: int) -> Sequence[float]:
    """Return the first numbers of a tag of GeoTIFF; raise ScanError for another type or fewer."""
    values = value if isinstance(value, tuple) else (value,)
    try:
        numbers = [float(item) for item in values[:count]]
    except (TypeError, ValueError, ArithmeticError):
        numbers = []
    if len(numbers) < count or isinstance(value, str | bytes) or not np.isfinite(numbers).all():
        found_value = repr(value)[:60]
        raise ScanError(f"{path}: tag {name} is {found_value}, expected {count} numbers or more")
    return numbers
