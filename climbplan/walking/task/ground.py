"""Terrain: convex footholds, level or sloped, and what a toe has to clear.

Each region is a convex piece of a plane, seen from above a rectangle with sides along x and y or a
polygon. What no region covers is a gap: nothing stands there, and nothing has to be cleared.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climbplan.arrays import Array, IntArray

_FAR = 900.0  # [m]


@dataclass(frozen=True)
class Ground:
    """Convex regions on which toes may stand; friction is the same everywhere."""

    names: tuple[str, ...]
    lower: Array  # (S, 2) x, y [m] of the rectangle about each region
    upper: Array  # (S, 2)
    height: Array  # (S,) at `inner` [m]
    friction: float
    slope: Array  # (S, 2) rise along x and y
    corners: Array  # (S, C, 2) counterclockwise, the last ones repeated; C = 0: all are rectangles
    edge: float = 0.0  # [m] from edges within which no toe is set down
    standoff: float = 0.0  # [m] radius of spherical feet, whose centres stand on these planes

    @classmethod
    def level(
        cls, names: tuple[str, ...], lower: Array, upper: Array, height: Array, friction: float
    ) -> Ground:
        """Level rectangles."""
        count = len(names)
        flat, none = np.zeros((count, 2)), np.zeros((count, 0, 2))
        return cls(names, lower, upper, height, friction, flat, none)

    @classmethod
    def flat(cls, friction: float) -> Ground:
        """One region without end at height 0."""
        far = np.full((1, 2), 1e3)
        return cls.level(("ground",), -far, far, np.zeros(1), friction)

    @property
    def count(self) -> int:
        """Regions."""
        return len(self.height)

    @cached_property
    def rough(self) -> bool:
        """Not one level region."""
        return self.count > 1 or bool(self.slope.any())

    @cached_property
    def endless(self) -> bool:
        """Flat ground at height 0, so far that nobody comes to its end."""
        far = (self.lower < -_FAR).all() and (self.upper > _FAR).all()
        return bool(self.count == 1 and far and not self.height.any() and not self.slope.any())

    @cached_property
    def inner(self) -> Array:
        """(S, 2) a point inside each region."""
        if not self.corners.shape[1]:
            return 0.5 * (self.lower + self.upper)
        middle: Array = self.corners.mean(axis=1)
        return middle

    @cached_property
    def sides(self) -> Array:
        """(S, C, 3) half-planes a x + b y <= c of polygons, beside those of `lower`, `upper`.

        (a, b) has length one; repeated corners give 0 <= 1.
        """
        along = np.roll(self.corners, -1, axis=1) - self.corners
        length = np.linalg.norm(along, axis=-1, keepdims=True)
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        outward = np.where(length > 1e-9, outward / np.maximum(length, 1e-12), 0.0)
        bound = (outward * self.corners).sum(axis=-1, keepdims=True)
        return np.concatenate([outward, np.where(length > 1e-9, bound, 1.0)], axis=-1)

    @cached_property
    def footholds(self) -> tuple[Array, Array, Array]:
        """`lower`, `upper` and `sides` less the strips along edges: where toes are set down."""
        sides = self.sides.copy()
        sides[..., 2] -= np.where(sides[..., :2].any(axis=-1), self.edge, 0.0)
        return self.lower + self.edge, self.upper - self.edge, sides

    @cached_property
    def frame(self) -> Array:
        """(S, 3, 3) rows: two tangents of each region, the first along x, and its normal."""
        x, y = self.slope[:, 0], self.slope[:, 1]
        one = np.ones(self.count)
        normal = np.column_stack([-x, -y, one]) / np.sqrt(1.0 + x**2 + y**2)[:, None]
        tangent = np.column_stack([one, 0.0 * one, x]) / np.sqrt(1.0 + x**2)[:, None]
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=1)

    def level_at(self, region: IntArray, xy: Array) -> Array:
        """Height (...) of the planes of regions (...) at points (..., 2) [m]."""
        rise: Array = self.height[region]
        if self.slope.any():
            rise = rise + (self.slope[region] * (xy - self.inner[region])).sum(axis=-1)
        return rise

    def outline(self, region: int, low: Array, high: Array) -> Array:
        """Corners (C, 3) of a region counterclockwise, within a rectangle; none if outside it."""
        if self.corners.shape[1]:
            corners = self.corners[region]
            apart = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) > 1e-9
            xy = corners[apart]
            if (xy.max(axis=0) <= low).any() or (xy.min(axis=0) >= high).any():
                return np.zeros((0, 3))
        else:
            (x0, y0), (x1, y1) = (
                np.maximum(self.lower[region], low),
                np.minimum(self.upper[region], high),
            )
            if x0 >= x1 or y0 >= y1:
                return np.zeros((0, 3))
            xy = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)
        level = self.level_at(np.full(len(xy), region), xy)
        return np.column_stack([xy, level])

    def outside(self, region: IntArray, xy: Array) -> Array:
        """How far points (..., 2) are from being inside their regions (...) [m]; <= 0 inside."""
        beyond = np.maximum(self.lower[region] - xy, xy - self.upper[region])
        worst: Array = beyond.max(axis=-1)
        if self.corners.shape[1]:
            rows = self.sides[region]  # (..., C, 3)
            past = (rows[..., :2] * xy[..., None, :]).sum(axis=-1) - rows[..., 2]
            worst = np.maximum(worst, past.max(axis=-1))
        return worst

    def nearest(self, xy: Array) -> IntArray:
        """The region (...) that each point (..., 2) is in, or least far from."""
        beyond = np.maximum(self.lower - xy[..., None, :], xy[..., None, :] - self.upper)
        apart = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)  # (..., S)
        deep = beyond.max(axis=-1)
        if self.corners.shape[1]:
            every = np.arange(self.count)
            deep = self.outside(every, xy[..., None, :])
            apart = np.maximum(apart, deep)
        # Inside several (never for regions that do not overlap) the one further inside.
        chosen: IntArray = np.argmin(apart + 1e-6 * deep, axis=-1)
        return chosen

    def into(self, region: IntArray, xy: Array) -> Array:
        """Points (..., 2) brought to footholds of regions (...): of polygons towards `inner`."""
        lower, upper, sides = self.footholds
        spot: Array = np.clip(xy, lower[region], upper[region])
        if self.corners.shape[1]:
            rows, middle = sides[region], self.inner[region]
            past = (rows[..., :2] * spot[..., None, :]).sum(axis=-1) - rows[..., 2]
            room = rows[..., 2] - (rows[..., :2] * middle[..., None, :]).sum(axis=-1)
            back = np.where(past > 0, past / np.maximum(past + room, 1e-12), 0.0).max(axis=-1)
            spot = spot + back[..., None] * (middle - spot)
        return spot

    def clearance_height(self, region: IntArray) -> Array:
        """Ground that a toe has to clear at each knot (N + 1, L), from its regions (N + 1, L).

        The higher of where it left and where it will stand; regions of swinging toes are those
        they are on the way to, so that the knot before tells where they come from. Of regions that
        are level: `kernels/ways.py` has what lies between, and slopes.
        """
        level = self.height[region]
        before = np.concatenate([level[:1], level[:-1]])
        higher: Array = np.maximum(level, before)
        return higher
