"""Parallel projection of the world onto a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array


@dataclass(frozen=True)
class OrthographicCamera:
    """A viewer infinitely far away in the direction of azimuth (from x, about z) and elevation."""

    azimuth_deg: float
    elevation_deg: float

    @property
    def axes(self) -> Array:
        """Rows right, up, towards the viewer: (3, 3) unit vectors in the world."""
        az, el = np.deg2rad(self.azimuth_deg), np.deg2rad(self.elevation_deg)
        right = [-np.sin(az), np.cos(az), 0.0]
        up = [-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)]
        toward = [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)]
        return np.array([right, up, toward])

    def project(self, points: Array) -> Array:
        """Return picture coordinates (..., 2) of world points (..., 3) [m]."""
        return np.asarray(points) @ self.axes[:2].T

    def depth(self, points: Array) -> Array:
        """Return distance towards the viewer (...) of world points (..., 3) [m]."""
        depth: Array = np.asarray(points) @ self.axes[2]
        return depth

    def faces_viewer(self, normal: Array) -> bool:
        """Return whether a face with this outward normal is seen from its outside."""
        return float(self.axes[2] @ normal) > 1e-9


def choose_clear_view(
    azimuth_deg: float, elevation_deg: float, path: Array, blocks: Array
) -> OrthographicCamera:
    """Return the camera at plus or minus an azimuth, on the side where blocks stand less in the
    way.

    path: (P, 3) what is to be seen; blocks: (B, 3) corners of what may hide it [m].
    """
    camera = OrthographicCamera(azimuth_deg, elevation_deg)
    if len(blocks) == 0 or camera.depth(blocks).mean() <= camera.depth(path).mean():
        return camera
    return OrthographicCamera(-azimuth_deg, elevation_deg)


FRONT = OrthographicCamera(-90.0, 0.0)  # x to the right, z up
SIDE = OrthographicCamera(0.0, 0.0)  # y to the right, z up


def compute_silhouette(points: Array) -> Array:
    """Return corners of the convex outline of projected points (K, 2); two ends if all lie on a
    line.
    """
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        spread = points - points.mean(axis=0)
        line_coordinate = spread @ np.linalg.svd(spread)[2][0]
        return points[[np.argmin(line_coordinate), np.argmax(line_coordinate)]]
