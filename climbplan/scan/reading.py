"""From a file to a scan in the world. Nothing in a file is ever run."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from climbplan.reading import reading
from climbplan.scan.cleaning import clean_mesh, remove_outliers
from climbplan.scan.clouds import CLOUDS, read_cloud
from climbplan.scan.heights import HEIGHTS, read_heights
from climbplan.scan.meshes import MESHES, read_mesh
from climbplan.scan.raw import RawScan, ScanError, select_within_box, transform_to_world
from climbplan.scan.relief import triangulate_cloud
from climbplan.schema.terrain.scan import ScanSpec

_log = logging.getLogger(__name__)

LARGEST_FILE = 2_000_000_000  # [bytes]
LARGEST = 1000.0  # [m] beyond which lengths are another unit's
SMALLEST = 0.05  # [m]
EXPECTED = (
    f"expected a mesh ({', '.join(MESHES)}), a point cloud ({', '.join(CLOUDS)}) or a height map "
    f"({', '.join(HEIGHTS)})"
)


def read_scan(spec: ScanSpec, directory: Path) -> RawScan:
    """Read the scan that a spec names, as clean triangles in the world; notes say what was done.

    Args:
        spec: The keys of the scan.
        directory: Where a relative path starts.

    Raises:
        ScanError: What is wrong with the file and what was expected.
    """
    path = directory / spec.file
    # Cleaning, too, is done in bounded memory
    with reading(path, EXPECTED.removeprefix("expected "), ScanError, damage=()):
        return _clean_scan(path, spec)


def _clean_scan(path: Path, spec: ScanSpec) -> RawScan:
    """Return the scan in the world, cropped and cleaned."""
    raw = _read_file(path, spec)
    if not len(raw.vertices):
        raise ScanError(f"{path}: empty, expected triangles, points or heights")
    finite = np.asarray(np.isfinite(raw.vertices).all(axis=1))
    if not finite.any():
        raise ScanError(f"{path}: no coordinate is a number, expected lengths")
    raw = _remove_infinite(raw, finite)
    raw = transform_to_world(raw, spec)
    _require_size(raw, path, spec)
    if spec.crop is not None:
        lower, upper = np.array(spec.crop.lower), np.array(spec.crop.upper)
        extent = _format_extent(raw)
        raw = select_within_box(raw, lower, upper)
        if not len(raw.vertices):
            raise ScanError(f"{path}: nothing is left within `crop`; the scan reaches {extent}")
    if not len(raw.triangles):
        raw = triangulate_cloud(remove_outliers(raw), path)
    clean = clean_mesh(raw)
    if not len(clean.triangles):
        raise ScanError(f"{path}: no triangle has an area, expected a surface")
    return clean


def _read_file(path: Path, spec: ScanSpec) -> RawScan:
    """Read a file by its suffix."""
    suffix = path.suffix.lower()
    if path.is_dir():
        raise ScanError(f"{path}: a directory, {EXPECTED}")
    if suffix not in (*MESHES, *CLOUDS, *HEIGHTS):
        raise ScanError(f"{path}: unknown kind of file {suffix!r}, {EXPECTED}")
    size = path.stat().st_size
    if size == 0:
        raise ScanError(f"{path}: empty file, {EXPECTED}")
    if size > LARGEST_FILE:
        raise ScanError(f"{path}: {size / 1e9:.1f} GB, expected at most {LARGEST_FILE / 1e9:g} GB")
    if suffix in HEIGHTS or (suffix == ".npy" and spec.cell is not None):
        return read_heights(path, spec)
    if suffix in MESHES:
        raw = read_mesh(path)
        if len(raw.triangles) or suffix != ".ply":
            return raw
    return read_cloud(path)


def _remove_infinite(raw: RawScan, finite: np.ndarray) -> RawScan:
    """Return the scan without vertices that are no numbers and their triangles, with a note."""
    lost = int((~finite).sum())
    if not lost:
        return raw
    keep = finite[raw.triangles].all(axis=1)
    number = np.cumsum(finite) - 1
    normals = None if raw.normals is None else raw.normals[finite]
    note = f"{lost} points that are no numbers left out"
    return RawScan(
        raw.vertices[finite],
        number[raw.triangles[keep]],
        raw.label[keep],
        raw.labels,
        normals,
        (*raw.notes, note),
    )


def _format_extent(raw: RawScan) -> str:
    """Return the bounds of a scan: "x -1 to 1, y -1 to 1, z 0 to 2.5 m"."""
    low, high = raw.vertices.min(axis=0), raw.vertices.max(axis=0)
    ends = (f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return f"{', '.join(ends)} m"


def _require_size(raw: RawScan, path: Path, spec: ScanSpec) -> None:
    """Raise ScanError for lengths in which no robot could climb: the unit is then another one."""
    size = float(np.ptp(raw.vertices, axis=0).max())
    if size > LARGEST and spec.crop is None:
        raise ScanError(
            f"{path}: {size:.4g} m across ({_format_extent(raw)}); is its unit the metre? Expected "
            f"at most {LARGEST:g} m: `scale: 0.001` reads millimetres, `crop` takes a part"
        )
    if size < SMALLEST:
        raise ScanError(
            f"{path}: {1e3 * size:.3g} mm across; is its unit the metre? Expected at least "
            f"{1e3 * SMALLEST:g} mm: `scale` gives the length of one unit of the file"
        )
