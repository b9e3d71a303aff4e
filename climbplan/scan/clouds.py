"""Point clouds: PCD, PLY without faces, XYZ text, NPY, and LAS where laspy is installed."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from climbplan.errors import MissingSolver
from climbplan.robots.rotations import Array
from climbplan.scan.pcd import read_pcd
from climbplan.scan.raw import RawScan, ScanError

CLOUDS = (".pcd", ".ply", ".xyz", ".txt", ".pts", ".npy", ".las", ".laz")


def cloud(points: Array, normals: Array | None = None) -> RawScan:
    """Points (P, 3) without triangles."""
    none = np.zeros((0, 3), np.int64)
    return RawScan(points, none, np.zeros(0, np.int64), normals=normals)


def read_cloud(path: Path) -> RawScan:
    """Points of a file, and their normals where it has them; raises ScanError."""
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        return cloud(*read_pcd(path))
    if suffix in (".las", ".laz"):
        return cloud(_read_las(path))
    if suffix == ".npy":
        return _columns(path, read_array(path))
    if suffix == ".ply":
        from climbplan.scan.meshes import read_mesh

        return cloud(read_mesh(path).vertices)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without data, which are refused below
            data = np.loadtxt(path, comments=("#", "//"), ndmin=2, max_rows=50_000_000)
    except (ValueError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise ScanError(
            f"{path}: not a list of points ({reason}), expected x y z a line"
        ) from error
    return _columns(path, data)


def read_array(path: Path) -> Array:
    """A NumPy array of numbers; nothing that is pickled is opened."""
    try:
        data = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise ScanError(f"{path}: not a NumPy array of numbers ({error})") from error
    if not isinstance(data, np.ndarray) or data.dtype.kind not in "fiu":
        raise ScanError(f"{path}: expected one array of numbers")
    return np.asarray(data, float)


def _columns(path: Path, data: Array) -> RawScan:
    """x, y, z, and normals where there are six columns of which three are of unit length."""
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
    return cloud(data[:, :3], normals)


def _read_las(path: Path) -> Array:
    try:
        import laspy
    except ImportError as error:
        raise MissingSolver(
            f"{path}: LAS files need laspy: pip install 'climbplan[scan]'"
        ) from error
    try:
        read = laspy.read(path)
        return np.asarray(read.xyz, float)
    except Exception as error:  # whatever its reader trips over in a broken file
        raise ScanError(f"{path}: not a LAS cloud ({error})") from error
