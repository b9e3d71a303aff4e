"""Level terrain: convex regions at heights of their own, and what a toe has to clear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Ground:
    """Rectangles, each level, on which toes may stand; friction is the same everywhere."""

    names: tuple[str, ...]
    lower: Array  # (S, 2) x, y [m]
    upper: Array  # (S, 2)
    height: Array  # (S,) [m]
    friction: float

    @classmethod
    def flat(cls, friction: float) -> Ground:
        """One region without end at height 0."""
        far = np.full((1, 2), 1e3)
        return cls(("ground",), -far, far, np.zeros(1), friction)

    def outside(self, region: Whole, xy: Array) -> Array:
        """How far points (..., 2) are from being inside their regions (...) [m]; <= 0 inside."""
        beyond = np.maximum(self.lower[region] - xy, xy - self.upper[region])
        worst: Array = beyond.max(axis=-1)
        return worst

    def nearest(self, xy: Array) -> Whole:
        """The region (...) that each point (..., 2) is in, or least far from."""
        beyond = np.maximum(self.lower - xy[..., None, :], xy[..., None, :] - self.upper)
        apart = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)  # (..., S)
        # Inside several (never for regions that do not overlap) the one further inside.
        chosen: Whole = np.argmin(apart + 1e-6 * beyond.max(axis=-1), axis=-1)
        return chosen

    def clearance_height(self, region: Whole) -> Array:
        """Ground that a toe has to clear at each knot (N + 1, L), from its regions (N + 1, L).

        The higher of where it left and where it will stand; regions of swinging toes are those
        they are on the way to, so that the knot before tells where they come from.
        """
        level = self.height[region]
        before = np.concatenate([level[:1], level[:-1]])
        higher: Array = np.maximum(level, before)
        return higher
