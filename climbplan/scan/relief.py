"""Surface of a point cloud: a relief over the plane that fits it best."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from climbplan.arrays import Array
from climbplan.scan.convex import compute_cross
from climbplan.scan.raw import RawScan, ScanError, build_mesh

_MAX_EDGE_RATIO = 4.0  # of an edge over the median spacing
_MAX_FOLDED_RATIO = 0.05  # of cells with points one above another
_MAX_HEIGHT_SPREAD = 6.0  # of the points of one cell, in spacings
_CELL = 2.0  # spacings


def triangulate_cloud(cloud: RawScan, path: Path) -> RawScan:
    """Triangulate a point cloud: a Delaunay triangulation without long edges; the rest is holes.

    It faces where most normals of the file do, else up, or, for a wall, towards the scan's origin.

    Raises:
        ScanError: The cloud is no relief, as of a whole cave.
    """
    points = cloud.vertices
    if len(points) < 10:
        raise ScanError(f"{path}: {len(points)} points, expected a cloud of at least 10")
    center = points.mean(axis=0)
    axes = np.linalg.svd(points - center, full_matrices=False)[2]
    normal = axes[2] * _choose_side(axes[2], cloud, center)
    across = axes[0]
    frame = np.stack([across, np.cross(normal, across), normal])
    local = (points - center) @ frame.T  # (P, 3)
    spacing = float(np.median(cKDTree(points).query(points, 5)[0][:, 4]))
    _require_relief(local, spacing, path)
    try:
        triangles = Delaunay(local[:, :2]).simplices.astype(np.int64)
    except QhullError as error:
        raise ScanError(f"{path}: its points lie on one line, expected a surface") from error
    corners = local[triangles]
    signed_area = compute_cross(
        corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    )
    triangles = np.where(signed_area[:, None] < 0, triangles[:, ::-1], triangles)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    is_short = edges.max(axis=1) <= _MAX_EDGE_RATIO * spacing
    surface = build_mesh(points, triangles[is_short])
    facing = ", ".join(f"{v:.2f}" for v in normal)
    return surface.add_notes(
        *cloud.notes,
        f"{len(points)} points, {1e3 * spacing:.1f} mm apart, joined to {int(is_short.sum())} "
        f"triangles as a relief that faces ({facing})",
    )


def _choose_side(normal: Array, cloud: RawScan, center: Array) -> float:
    """Return 1 or -1: the side of the plane that is free space."""
    if cloud.normals is not None:
        side = float(np.sign(cloud.normals @ normal).sum())
        if side:
            return float(np.sign(side))
    upright = abs(normal[2]) < 0.5
    side = -float(center @ normal) if upright else float(normal[2])
    return 1.0 if side >= 0 else -1.0


def _require_relief(local: Array, spacing: float, path: Path) -> None:
    """Raise ScanError for points (P, 3) of which many lie one above another."""
    cell = np.floor(local[:, :2] / (_CELL * spacing)).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.reshape(-1)
    low = np.full(number.max() + 1, np.inf)
    high = -low
    np.minimum.at(low, number, local[:, 2])
    np.maximum.at(high, number, local[:, 2])
    folded = float((high - low > _MAX_HEIGHT_SPREAD * spacing).mean())
    if folded > _MAX_FOLDED_RATIO:
        raise ScanError(
            f"{path}: {folded:.0%} of the cloud has points one above another, seen along the "
            "normal of its plane; expected a relief (ground, a wall): `crop` one, or give a mesh"
        )
