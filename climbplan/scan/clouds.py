"""Point clouds: PCD, PLY without faces, XYZ text, NPY, and LAS where laspy is installed."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import MissingSolver
from climbplan.reading import ANY_ERROR, reading
from climbplan.scan.pcd import read_pcd
from climbplan.scan.raw import RawScan, ScanError

CLOUDS = (".pcd", ".ply", ".xyz", ".txt", ".pts", ".npy", ".las", ".laz")


def build_cloud(points: Array, normals: Array | None = None) -> RawScan:
    """Return points (P, 3) without triangles."""
    none = np.zeros((0, 3), np.int64)
    return RawScan(points, none, np.zeros(0, np.int64), normals=normals)


def read_cloud(path: Path) -> RawScan:
    """Read the points of a file, and their normals where it has them.

    Raises:
        ScanError: The file is no cloud.
        MissingSolver: laspy is not installed.
    """
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        return build_cloud(*read_pcd(path))
    if suffix in (".las", ".laz"):
        return build_cloud(_read_las(path))
    if suffix == ".npy":
        return _build_from_columns(path, read_array(path))
    if suffix == ".ply":
        from climbplan.scan.meshes import read_mesh

        return build_cloud(read_mesh(path).vertices)
    with reading(path, "a list of points, x y z a line", ScanError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files without data, which are refused below
        data = np.loadtxt(path, comments=("#", "//"), ndmin=2, max_rows=50_000_000)
    return _build_from_columns(path, data)


def read_array(path: Path) -> Array:
    """Return a NumPy array of numbers; nothing that is pickled is opened."""
    with reading(path, "a NumPy array of numbers", ScanError):
        # Mapped, not read: what a header claims has to be in the file
        data = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(data, np.ndarray) or data.dtype.kind not in "fiu":
            raise ScanError(f"{path}: expected one array of numbers")
        return np.array(data, float)


def _build_from_columns(path: Path, data: Array) -> RawScan:
    """Return x, y, z, and normals where there are six columns of which three are unit vectors."""
    if data.ndim != 2 or data.shape[1] < 3:
        hint = "; for a height map give `cell`" if data.ndim == 2 else ""
        raise ScanError(f"{path}: expected points in rows of x, y, z, got {data.shape}{hint}")
    if data.shape[1] > 32:
        raise ScanError(
            f"{path}: rows of {data.shape[1]} numbers, expected x, y, z; for a height map give "
            "`cell`, the width of a cell"
        )
    normals = None
    if data.shape[1] == 6:
        lengths = np.linalg.norm(data[:, 3:], axis=1)
        if len(lengths) and np.abs(lengths - 1).max() < 1e-2:
            normals = data[:, 3:]
    return build_cloud(data[:, :3], normals)


def _read_las(path: Path) -> Array:
    """Read the points of a LAS file."""
    try:
        import laspy
    except ImportError as error:
        raise MissingSolver(
            f"{path}: LAS files need laspy: pip install 'climbplan[scan]'"
        ) from error
    with reading(path, "a LAS cloud", ScanError, damage=ANY_ERROR):
        read = laspy.read(path)
        return np.asarray(read.xyz, float)
