"""The body's way of a climb: from the start by the points of a scan's guide to the goal."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene


@dataclass(frozen=True)
class BodyWay:
    """The body's way from start to goal, by the points of a scan's guide if it has one."""

    points: Array  # (P, 3) [m]

    @classmethod
    def of(cls, scene: ClimbScene) -> BodyWay:
        """That of a scene; pieces without length are left out."""
        scan = scene.spec.terrain.scan
        between = [] if scan is None else [np.array(point, float) for point in scan.guide]
        points = [scene.start.com, *between, scene.goal.com]
        kept = [points[0]]
        kept += [b for a, b in itertools.pairwise(points) if np.linalg.norm(b - a) > 0]
        return cls(np.array(kept))

    @property
    def lengths(self) -> Array:
        """(P - 1,) of its pieces [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=0), axis=1))

    @property
    def length(self) -> float:
        """Of the whole [m]."""
        return float(self.lengths.sum())

    def at(self, distance: float) -> Array:
        """(3,) the place that far from the start [m]."""
        ends = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.array([np.interp(distance, ends, axis) for axis in self.points.T])

    def nearest(self, com: Array, covered: float) -> float:
        """How far along the place nearest to a body is [m], not before what was covered."""
        best, before, least = covered, 0.0, np.inf
        for (start, end), length in zip(itertools.pairwise(self.points), self.lengths, strict=True):
            share = float((com - start) @ (end - start)) / length**2
            share = min(max(share, 0.0), 1.0)
            away = float(np.linalg.norm(start + share * (end - start) - com))
            if before + length >= covered and away < least:
                best, least = max(before + share * length, covered), away
            before += length
        return best
