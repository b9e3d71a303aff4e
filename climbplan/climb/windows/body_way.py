"""The body's path of a climb: from the start along the points of a scan's guide to the goal."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene


@dataclass(frozen=True)
class BodyPath:
    """A polyline of the body from start to goal, by the points of a scan's guide if it has one."""

    points: Array  # (P, 3) [m]

    @classmethod
    def from_scene(cls, scene: ClimbScene) -> BodyPath:
        """Build the path of a scene; segments without length are left out."""
        scan = scene.spec.terrain.scan
        guide_points = [] if scan is None else [np.array(point, float) for point in scan.guide]
        points = [scene.start.com, *guide_points, scene.goal.com]
        distinct = [points[0]]
        distinct += [b for a, b in itertools.pairwise(points) if np.linalg.norm(b - a) > 0]
        return cls(np.array(distinct))

    @property
    def lengths(self) -> Array:
        """Lengths (P - 1,) of the segments [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=0), axis=1))

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.lengths.sum())

    def interpolate(self, distance: float) -> Array:
        """Interpolate the point (3,) at a distance from the start along the path [m]."""
        ends = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.array([np.interp(distance, ends, axis) for axis in self.points.T])

    def project(self, com: Array, covered: float) -> float:
        """Project a position to the path; return the distance from the start, >= covered [m]."""
        best, length_before, min_distance = covered, 0.0, np.inf
        for (start, end), length in zip(itertools.pairwise(self.points), self.lengths, strict=True):
            fraction = float((com - start) @ (end - start)) / length**2
            fraction = min(max(fraction, 0.0), 1.0)
            distance = float(np.linalg.norm(start + fraction * (end - start) - com))
            if length_before + length >= covered and distance < min_distance:
                best, min_distance = max(length_before + fraction * length, covered), distance
            length_before += length
        return best
