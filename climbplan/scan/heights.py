"""Height maps as triangles: GeoTIFF and PNG by Pillow, NPY, CSV."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.scan.clouds import read_array
from climbplan.scan.raw import RawScan, ScanError, mesh
from climbplan.spec.climb.scan import ScanSpec

HEIGHTS = (".tif", ".tiff", ".png", ".csv")
_PIXEL_SCALE, _TIEPOINT, _NO_DATA = 33550, 33922, 42113  # tags of GeoTIFF
_MOST = 25_000_000  # cells


def read_heights(path: Path, spec: ScanSpec) -> RawScan:
    """Two triangles a cell, north up: x grows with columns and y against rows in images.

    In NPY and CSV y grows with rows. Cells without a number are holes. Raises ScanError.
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
    if heights.size > _MOST:
        raise ScanError(f"{path}: {heights.size} heights, expected at most {_MOST}")
    if cell is None:
        raise ScanError(f"{path}: a height map without `cell`, expected the width of a cell [m]")
    if spec.origin is not None:
        origin = np.array(spec.origin)
    elif corner is not None:
        origin = corner
    else:
        origin = np.zeros(3)
    rows, columns = heights.shape
    row, column = np.indices(heights.shape)
    y = (rows - 1 - row) * cell if image and corner is None else row * cell
    if corner is not None:
        y = -row * cell  # a tiepoint is the north-west corner
    points = np.stack([column * cell, y, spec.height * heights], axis=-1) + origin
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
    raw = mesh(flat, triangles)
    if not len(triangles):
        raise ScanError(f"{path}: no four heights beside one another are numbers")
    return raw.noted(f"{missing} of {heights.size} heights missing") if missing else raw


_CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))


def _read_csv(path: Path) -> Array:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without data, which are refused later
            text = path.read_text()
            delimiter = next((d for d in ",;\t" if d in text), None)
            return np.genfromtxt(text.splitlines(), delimiter=delimiter, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise ScanError(f"{path}: not a table of heights ({str(error).splitlines()[0]})") from error


def _read_image(path: Path) -> tuple[Array, float | None, Array | None]:
    """Heights, width of a cell and place of the first one, as far as the file says them."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged tags, which are not needed
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                if image.width * image.height > _MOST:
                    size = image.width * image.height
                    raise ScanError(f"{path}: {size} heights, expected at most {_MOST}")
                if image.mode in ("RGB", "RGBA", "P", "CMYK", "YCbCr"):
                    raise ScanError(f"{path}: a picture in colours, expected one height a pixel")
                heights = np.asarray(image, float)
                tags = dict(getattr(image, "tag_v2", {}))
    except ScanError:
        raise
    except (
        UnidentifiedImageError,
        Image.DecompressionBombWarning,
        Image.DecompressionBombError,
        OSError,
        ValueError,
        SyntaxError,
    ) as error:
        raise ScanError(f"{path}: not an image of heights ({error})") from error
    try:
        nothing = float(str(tags[_NO_DATA]).strip("\0 "))
        heights = np.where(heights == nothing, np.nan, heights)
    except (KeyError, ValueError):
        pass
    if _PIXEL_SCALE not in tags:
        return heights, None, None
    across, along = (float(v) for v in tags[_PIXEL_SCALE][:2])
    if not (across > 0 and abs(across - along) < 1e-6 * across):
        raise ScanError(f"{path}: cells of {across:g} by {along:g}, expected square ones")
    tie = tags.get(_TIEPOINT)
    if tie is None or len(tie) < 6:
        return heights, across, None
    west, north = float(tie[3]) - tie[0] * across, float(tie[4]) + tie[1] * across
    return heights, across, np.array([west, north, 0.0])
