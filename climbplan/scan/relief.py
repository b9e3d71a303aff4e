"""A cloud of points as a surface: a relief over the plane that fits it best."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from climbplan.arrays import Array
from climbplan.scan.convex import crossed
from climbplan.scan.raw import RawScan, ScanError, mesh

_LONGEST = 4.0  # times the usual spacing that an edge may have
_FOLDED = 0.05  # share of places with points one above another
_STEEP = 6.0  # spacings that points of one place may be apart in height
_CELL = 2.0  # spacings


def surface_of_cloud(cloud: RawScan, path: Path) -> RawScan:
    """Neighbouring points joined to triangles, where they are close; the rest is holes.

    Faces where most normals of the file do, else up, or of a wall towards the scan's origin.
    Raises ScanError for a cloud that is no relief, such as of a whole cave.
    """
    points = cloud.vertices
    if len(points) < 10:
        raise ScanError(f"{path}: {len(points)} points, expected a cloud of at least 10")
    center = points.mean(axis=0)
    axes = np.linalg.svd(points - center, full_matrices=False)[2]
    out = axes[2] * _facing(axes[2], cloud, center)
    across = axes[0]
    frame = np.stack([across, np.cross(out, across), out])
    own = (points - center) @ frame.T  # (P, 3)
    spacing = float(np.median(cKDTree(points).query(points, 5)[0][:, 4]))
    _require_relief(own, spacing, path)
    try:
        triangles = Delaunay(own[:, :2]).simplices.astype(np.int64)
    except QhullError as error:
        raise ScanError(f"{path}: its points lie on one line, expected a surface") from error
    corners = own[triangles]
    turned = crossed(corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2])
    triangles = np.where(turned[:, None] < 0, triangles[:, ::-1], triangles)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    near = edges.max(axis=1) <= _LONGEST * spacing
    surface = mesh(points, triangles[near])
    facing = ", ".join(f"{v:.2f}" for v in out)
    return surface.noted(
        *cloud.notes,
        f"{len(points)} points, {1e3 * spacing:.1f} mm apart, joined to {int(near.sum())} "
        f"triangles as a relief that faces ({facing})",
    )


def _facing(normal: Array, cloud: RawScan, center: Array) -> float:
    """1 or -1: the side of the plane that is free space."""
    if cloud.normals is not None:
        side = float(np.sign(cloud.normals @ normal).sum())
        if side:
            return float(np.sign(side))
    upright = abs(normal[2]) < 0.5
    side = -float(center @ normal) if upright else float(normal[2])
    return 1.0 if side >= 0 else -1.0


def _require_relief(own: Array, spacing: float, path: Path) -> None:
    cell = np.floor(own[:, :2] / (_CELL * spacing)).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.reshape(-1)
    low = np.full(number.max() + 1, np.inf)
    high = -low
    np.minimum.at(low, number, own[:, 2])
    np.maximum.at(high, number, own[:, 2])
    folded = float((high - low > _STEEP * spacing).mean())
    if folded > _FOLDED:
        raise ScanError(
            f"{path}: {folded:.0%} of the cloud has points one above another, seen along the "
            "normal of its plane; expected a relief (ground, a wall): `crop` one, or give a mesh"
        )
