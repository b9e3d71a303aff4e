"""Parallel projection of the world onto a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.rotations import Array


@dataclass(frozen=True)
class Camera:
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
        """Picture coordinates (..., 2) of world points (..., 3) [m]."""
        return np.asarray(points) @ self.axes[:2].T

    def depth(self, points: Array) -> Array:
        """Distance towards the viewer (...) of world points (..., 3) [m]."""
        return np.asarray(points) @ self.axes[2]

    def faces_viewer(self, normal: Array) -> bool:
        """Whether a face with this outward normal is seen from its outside."""
        return float(self.axes[2] @ normal) > 1e-9


FRONT = Camera(-90.0, 0.0)  # x to the right, z up
SIDE = Camera(0.0, 0.0)  # y to the right, z up
OBLIQUE = Camera(-63.0, 18.0)
