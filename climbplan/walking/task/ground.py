"""Terrain of convex footholds, level or sloped, and the heights that toes have to clear.

A toe p stands on one convex region of a plane, seen from above a rectangle along x and y or a
polygon, with normal n and friction coefficient mu:

    contact.region    A (p_x, p_y) <= b,    p_z = h + s_x (p_x - o_x) + s_y (p_y - o_y)
    force.friction    || f - (n . f) n || <= mu n . f,    n = (-s_x, -s_y, 1) / | . |

Rectangles have A = (I, -I); level ones s = 0, so that n points up. What no region covers is a gap:
no toe stands there. Swings clear all regions and, of scanned terrain, the raw surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.task.height_grid import HeightGrid, build_empty_grid, build_height_grid

_FAR = 900.0  # [m]


class RegionArrays(NamedTuple):
    """S convex regions as compiled functions take them; the meaning is that of `Ground`."""

    lower: Array  # (S, 2) [m]
    upper: Array  # (S, 2) [m]
    sides: Array  # (S, C, 3)
    height: Array  # (S,) at `inner` [m]
    slope: Array  # (S, 2)
    inner: Array  # (S, 2) [m]
    grid: HeightGrid  # of the raw surface of a scan


def raise_scan(scan: RawSurface, rise: float) -> RawSurface:
    """Return a raw surface that is raised [m]."""
    return replace(scan, vertices=scan.vertices + rise * np.array([0.0, 0.0, 1.0]))


def _build_all_allowed() -> BoolArray:
    return np.zeros((0, 0), bool)


@dataclass(frozen=True)
class Ground:
    """Terrain of convex regions."""

    names: tuple[str, ...]
    lower: Array  # (S, 2) x, y [m] of the rectangle about each region
    upper: Array  # (S, 2)
    height: Array  # (S,) at `inner` [m]
    friction: float  # of regions without one of their own
    slope: Array  # (S, 2) rise along x and y
    corners: Array  # (S, C, 2) counterclockwise, the last ones repeated; C = 0: all are rectangles
    edge: float = 0.0  # [m] strip along edges without footholds
    standoff: float = 0.0  # [m] radius of spherical feet, whose centres stand on these planes
    region_friction: Array = field(default_factory=lambda: np.zeros(0))  # (S,); empty: `friction`
    # (S, L) bool, leg may stand on region; empty: all may
    allowed: BoolArray = field(default_factory=_build_all_allowed)
    scan: RawSurface | None = None  # raw surface, moved with the planes when these are raised

    @classmethod
    def level(
        cls, names: tuple[str, ...], lower: Array, upper: Array, height: Array, friction: float
    ) -> Ground:
        """Return terrain of level rectangles."""
        count = len(names)
        flat, none = np.zeros((count, 2)), np.zeros((count, 0, 2))
        return cls(names, lower, upper, height, friction, flat, none)

    @classmethod
    def flat(cls, friction: float) -> Ground:
        """Return one unbounded region at height 0."""
        far = np.full((1, 2), 1e3)
        return cls.level(("ground",), -far, far, np.zeros(1), friction)

    @property
    def count(self) -> int:
        """Number S of regions."""
        return len(self.height)

    @cached_property
    def is_rough(self) -> bool:
        """True if the terrain is more than one level region."""
        return self.count > 1 or bool(self.slope.any()) or self.scan is not None

    @cached_property
    def is_flat_everywhere(self) -> bool:
        """True if the terrain is flat at height 0 and practically unbounded."""
        far = (self.lower < -_FAR).all() and (self.upper > _FAR).all()
        return bool(self.count == 1 and far and not self.height.any() and not self.slope.any())

    @cached_property
    def inner(self) -> Array:
        """A point (S, 2) inside each region."""
        if not self.corners.shape[1]:
            return 0.5 * (self.lower + self.upper)
        middle: Array = self.corners.mean(axis=1)
        return middle

    @cached_property
    def sides(self) -> Array:
        """Half-planes (S, C, 3), a x + b y <= c, of polygons, in addition to `lower` and `upper`.

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
        """Bounds `lower`, `upper` and `sides` of admissible footholds, without edge strips."""
        sides = self.sides.copy()
        sides[..., 2] -= np.where(sides[..., :2].any(axis=-1), self.edge, 0.0)
        return self.lower + self.edge, self.upper - self.edge, sides

    @cached_property
    def region_arrays(self) -> RegionArrays:
        """The whole regions as compiled functions take them."""
        shape = (self.lower, self.upper, self.sides, self.height, self.slope, self.inner)
        return RegionArrays(*shape, self.height_grid)

    @cached_property
    def foothold_arrays(self) -> RegionArrays:
        """The regions without strips along edges, as compiled functions take them."""
        lower, upper, sides = self.footholds
        shape = (lower, upper, sides, self.height, self.slope, self.inner)
        return RegionArrays(*shape, build_empty_grid())

    @cached_property
    def height_grid(self) -> HeightGrid:
        """Upper bounds of the raw surface; without a scan it has no cells."""
        return build_empty_grid() if self.scan is None else build_height_grid(self.scan)

    @cached_property
    def max_swept_height(self) -> float:
        """An upper bound of the heights of all level regions, and of the raw surface [m]."""
        cells = self.height_grid.height
        return float(max(self.height.max(), cells.max() if cells.size else -np.inf))

    def list_regions(self, leg: int) -> IntArray:
        """Return the regions that a leg may stand on."""
        if not self.allowed.size:
            return np.arange(self.count)
        return np.flatnonzero(self.allowed[:, leg])

    @cached_property
    def leg_foothold_arrays(self) -> tuple[RegionArrays, ...]:
        """Footholds of each leg's own regions, in the order of `list_regions`; empty: all alike."""
        arrays = self.foothold_arrays
        regions_of_leg = [self.list_regions(leg) for leg in range(self.allowed.shape[1])]
        return tuple(
            RegionArrays(
                arrays.lower[regions],
                arrays.upper[regions],
                arrays.sides[regions],
                arrays.height[regions],
                arrays.slope[regions],
                arrays.inner[regions],
                arrays.grid,
            )
            for regions in regions_of_leg
        )

    def find_friction(self, region: IntArray) -> Array:
        """Return the friction coefficients (...) of regions (...)."""
        if not self.region_friction.size:
            return np.full(np.shape(region), self.friction)
        return np.asarray(self.region_friction[region])

    @cached_property
    def frame(self) -> Array:
        """Rows (S, 3, 3): two tangents of each region, the first along x, and its normal."""
        x, y = self.slope[:, 0], self.slope[:, 1]
        ones = np.ones(self.count)
        normal = np.column_stack([-x, -y, ones]) / np.sqrt(1.0 + x**2 + y**2)[:, None]
        tangent = np.column_stack([ones, 0.0 * ones, x]) / np.sqrt(1.0 + x**2)[:, None]
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=1)

    @property
    def min_friction(self) -> float:
        """The smallest friction coefficient of all regions."""
        return float(self.region_friction.min()) if self.region_friction.size else self.friction

    def compute_height(self, region: IntArray, xy: Array) -> Array:
        """Return heights (...) of the planes of regions (...) at points (..., 2) [m]."""
        rise: Array = self.height[region]
        if self.slope.any():
            rise = rise + (self.slope[region] * (xy - self.inner[region])).sum(axis=-1)
        return rise

    def outline(self, region: int, low: Array, high: Array) -> Array:
        """Return corners (C, 3) of a region counterclockwise, clipped to a rectangle."""
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
        level = self.compute_height(np.full(len(xy), region), xy)
        return np.column_stack([xy, level])

    def compute_distance_outside(self, region: IntArray, xy: Array) -> Array:
        """Return how far points (..., 2) are outside their regions (...) [m], <= 0 inside."""
        beyond = np.maximum(self.lower[region] - xy, xy - self.upper[region])
        worst: Array = beyond.max(axis=-1)
        if self.corners.shape[1]:
            rows = self.sides[region]  # (..., C, 3)
            excess = (rows[..., :2] * xy[..., None, :]).sum(axis=-1) - rows[..., 2]
            worst = np.maximum(worst, excess.max(axis=-1))
        return worst

    def nearest(self, xy: Array) -> IntArray:
        """Return the region (...) that contains each point (..., 2), or is nearest to it."""
        beyond = np.maximum(self.lower - xy[..., None, :], xy[..., None, :] - self.upper)
        apart = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)  # (..., S)
        deep = beyond.max(axis=-1)
        if self.corners.shape[1]:
            every = np.arange(self.count)
            deep = self.compute_distance_outside(every, xy[..., None, :])
            apart = np.maximum(apart, deep)
        # Among several regions that contain a point: the one with the largest depth.
        chosen: IntArray = np.argmin(apart + 1e-6 * deep, axis=-1)
        return chosen

    def find_start_regions(self, toes: Array) -> IntArray:
        """Return the region (L,) of each leg's own that contains its toe (L, 2), or is nearest."""
        if not self.allowed.size:
            return self.nearest(toes)
        every = [self.list_regions(leg) for leg in range(len(toes))]
        distance = [self.compute_distance_outside(r, xy) for r, xy in zip(every, toes, strict=True)]
        return np.array([r[int(np.argmin(d))] for r, d in zip(every, distance, strict=True)])

    def project(self, region: IntArray, xy: Array) -> Array:
        """Return points (..., 2) moved into the footholds of regions (...)."""
        lower, upper, sides = self.footholds
        spot: Array = np.clip(xy, lower[region], upper[region])
        if self.corners.shape[1]:
            rows, middle = sides[region], self.inner[region]
            excess = (rows[..., :2] * spot[..., None, :]).sum(axis=-1) - rows[..., 2]
            slack = rows[..., 2] - (rows[..., :2] * middle[..., None, :]).sum(axis=-1)
            pull = np.where(excess > 0, excess / np.maximum(excess + slack, 1e-12), 0.0).max(
                axis=-1
            )
            spot = spot + pull[..., None] * (middle - spot)
        return spot

    def compute_clearance_height(self, region: IntArray) -> Array:
        """Return the terrain height (N + 1, L) that toes have to clear [m].

        It is the higher one of lift-off and landing, for level regions. Regions of swinging toes
        are those of their landing. `kernels/swept_terrain.py` computes what lies between, and
        slopes.
        """
        level = self.height[region]
        before = np.concatenate([level[:1], level[:-1]])
        higher: Array = np.maximum(level, before)
        return higher
