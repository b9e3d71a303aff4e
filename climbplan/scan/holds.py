"""Graspable spots of a scanned wall: where two fingers close on what stands out of its plane.

The wall is the plane that most points lie in; the scan is a relief over it, z = h(u, v), in cells
of a few millimetres. At a place, with fingers that close along an axis t and reach a depth below
the surface there, each finger comes in from the gripper's opening until it touches the relief.
The slope of the relief there is that of the gripped side, with normal +-cos(u) t - sin(u) n and
undercut u as in `climbplan.terrain.holds`: 0 for a side at right angles to the wall, below 0 for
one that leans back. A relief is seen from before and shows no sides that are undercut (u > 0).

Places whose sides are steepest come first; what lies within a hold's size of a better one is left
out. Room for the grip's centre is the square about it in which grips of the same axis hold as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator

from climbplan.arrays import Array, BoolArray
from climbplan.scan.raw import RawScan, ScanError

_CELL = 2.5e-3  # [m] of the relief
_PLANE = 6e-3  # [m] from the wall's plane that still counts as it
_PASSES = 20
_STEPS = 12  # directions of fingers in half a turn
_FREE = 4e-3  # [m] that an open finger's place is below the depth at which it grips
_ALONG = 2.5e-3  # [m] to both sides of where a finger touches, over which its side's slope is taken
_ASIDE = np.sin(np.deg2rad(25.0))  # of the angle by which a side may face away from the axis
_NARROWEST = 0.3  # of the opening: fingers hold nothing thinner
_APART = 0.8  # of the opening, between the middles of two grips
_UNEVEN = 25.0  # [deg] by which the slopes of both sides may differ
_MOST_ROOM = 6  # cells from the middle


@dataclass(frozen=True)
class Grasping:
    """What a gripper needs of a hold."""

    opening: float  # [m] between its open fingers
    depth: float = 0.015  # [m] that fingers reach beside what they grip
    steepest_back: float = 45.0  # [deg] that a side may lean back at most


@dataclass(frozen=True)
class FoundHold:
    """A place at which a gripper closes."""

    at: tuple[float, float]  # [m] across the wall and up it
    rise: float  # [m] of the gripped sides before the wall's plane
    axis_deg: float  # from `up` towards `across`
    undercut_deg: float  # of the side that leans back most
    width: float  # [m] between the gripped sides
    room: float  # [m] across and up in which the grip's centre may be


@dataclass(frozen=True)
class Wall:
    """The plane of a scanned wall, and what can be gripped on it."""

    center: Array  # (3,) a point of it, world [m]
    across: Array  # (3,) unit, level
    up: Array  # (3,) unit
    normal: Array  # (3,) unit, into free space
    extent: tuple[tuple[float, float], tuple[float, float]]  # across and up, from and to [m]
    holds: tuple[FoundHold, ...]  # steepest sides first

    @property
    def angle_deg(self) -> float:
        """As that of a panel: 90 upright, above: overhanging."""
        return float(np.rad2deg(np.arccos(np.clip(self.normal[2], -1.0, 1.0))))

    @property
    def turn_deg(self) -> float:
        """About z, by which a panel, that faces -y, is turned to stand as the wall does."""
        return float(np.rad2deg(np.arctan2(self.across[1], self.across[0])))


def found_holds(scan: RawScan, grasping: Grasping) -> Wall:
    """The wall of a scan with its holds; raises ScanError where there is no wall or no hold."""
    points = scan.vertices
    center, normal = _plane(points, scan)
    across = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(across) < 1e-3:
        across = np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    own = (points - center) @ np.stack([across, up, normal]).T
    low, high = own[:, :2].min(axis=0), own[:, :2].max(axis=0)
    u, v = (np.arange(a, b, _CELL) for a, b in zip(low, high, strict=True))
    grid_u, grid_v = np.meshgrid(u, v, indexing="ij")
    height = LinearNDInterpolator(own[:, :2], own[:, 2])(grid_u, grid_v)
    known = np.isfinite(height)
    height = ndimage.gaussian_filter(np.where(known, height, 0.0), 1.0)
    height = np.where(known, height, np.nan)
    grips = _grips(height, grasping)
    holds = tuple(
        FoundHold(
            at=(float(u[g.row]), float(v[g.column])),
            rise=g.rise,
            axis_deg=180.0 / _STEPS * g.turn,
            undercut_deg=-g.back,
            width=g.width,
            room=g.room,
        )
        for g in grips
    )
    if not holds:
        rise = float(np.nanmax(height))
        raise ScanError(
            f"no graspable spot: what stands out of the wall's plane, {1e3 * rise:.0f} mm at most, "
            f"has no two sides within the gripper's opening of {1e3 * grasping.opening:.0f} mm "
            f"that go {1e3 * grasping.depth:.0f} mm down and lean back by at most "
            f"{grasping.steepest_back:.0f} degrees"
        )
    extent = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
    return Wall(center, across, up, normal, extent, holds)


def _plane(points: Array, scan: RawScan) -> tuple[Array, Array]:
    """A point and the normal of the plane that most points lie in, facing as the scan does."""
    kept: BoolArray = np.ones(len(points), bool)
    center, normal = points.mean(axis=0), np.zeros(3)
    for _ in range(_PASSES):
        center = points[kept].mean(axis=0)
        apart = points[kept] - center
        normal = np.linalg.eigh(apart.T @ apart)[1][:, 0]  # across which points spread least
        off = (points - center) @ normal
        kept = np.abs(off - np.median(off[kept])) <= _PLANE
        if kept.sum() < 10:
            raise ScanError("no wall in the scan: no plane that its points lie in")
    if len(scan.triangles):
        corners = scan.corners
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
        normal = normal * (np.sign(float(facing @ normal)) or 1.0)
    return center, np.asarray(normal)


@dataclass(frozen=True)
class _Grip:
    row: int
    column: int
    turn: int  # of _STEPS
    back: float  # [deg] that the sides lean back
    width: float  # [m]
    rise: float  # [m]
    room: float  # [m]


@dataclass(frozen=True)
class _Closed:
    """Fingers closed along one axis at every cell (U, V)."""

    back: Array  # [deg] that the side which leans back most does; infinite for no grip
    width: Array  # [m]


def _grips(height: Array, grasping: Grasping) -> list[_Grip]:
    """The best grips, none within most of an opening of a better one."""
    closed = [_closed(height, grasping, k) for k in range(_STEPS)]
    back = np.stack([c.back for c in closed])  # (T, U, V)
    best = back.argmin(axis=0)
    least = back.min(axis=0)
    # The same slope all along: in the middle of where it is, by the most room
    order = np.argsort(np.round(least, 1), axis=None, kind="stable")
    found: list[_Grip] = []
    apart = _APART * grasping.opening / _CELL
    for place in order:
        row, column = (int(i) for i in np.unravel_index(place, least.shape))
        if not np.isfinite(least[row, column]):
            break
        if any(np.hypot(g.row - row, g.column - column) < apart for g in found):
            continue
        turn = int(best[row, column])
        found.append(
            _Grip(
                row,
                column,
                turn,
                float(least[row, column]),
                float(closed[turn].width[row, column]),
                float(height[row, column] - grasping.depth),
                _room(back[turn], row, column, grasping.steepest_back),
            )
        )
    return found


def _room(back: Array, row: int, column: int, limit: float) -> float:
    """Side [m] of the largest square about a cell in which all grips hold."""
    for size in range(1, _MOST_ROOM + 1):
        rows, columns = slice(row - size, row + size + 1), slice(column - size, column + size + 1)
        part = back[max(rows.start, 0) : rows.stop, max(columns.start, 0) : columns.stop]
        if part.size < (2 * size + 1) ** 2 or (part > limit).any():
            return (2 * size - 1) * _CELL
    return (2 * _MOST_ROOM + 1) * _CELL


def _closed(height: Array, grasping: Grasping, turn: int) -> _Closed:
    """Fingers that close along an axis, from `up` (columns) towards `across` (rows)."""
    angle = np.pi * turn / _STEPS
    step = np.array([np.sin(angle), np.cos(angle)])  # cells a step, rows and columns
    most = int(np.floor(grasping.opening / 2 / _CELL))
    along = int(np.ceil(_ALONG / _CELL))
    rows, columns = np.indices(height.shape)

    def at(distance: float) -> Array:
        """Heights so many cells along the axis; outside the scan not a number."""
        where = [rows + distance * step[0], columns + distance * step[1]]
        return np.asarray(
            ndimage.map_coordinates(height, where, order=1, cval=np.nan, prefilter=False)
        )

    def looked_up(values: Array, distance: NDArray[np.intp]) -> Array:
        """Values at places that many cells along the axis, for each cell its own."""
        where = [rows + distance * step[0], columns + distance * step[1]]
        return np.asarray(ndimage.map_coordinates(values, where, order=1, cval=np.nan))

    gradient: list[Array] = list(np.gradient(height, _CELL))
    grip = height - grasping.depth  # where fingers touch
    sides, slopes, free = [], [], np.ones(height.shape, bool)
    for sign in (1, -1):
        profile = np.stack([at(sign * k) for k in range(most + along + 1)])  # (K, U, V)
        with np.errstate(invalid="ignore"):
            free &= profile[most] <= grip - _FREE  # an open finger finds room
            inside = profile[: most + 1] >= grip
        # Coming in from the opening: the last cell that stands in the finger's way
        last = most - np.argmax(inside[::-1], axis=0)
        steps = np.clip(np.stack([last - along, last + along]), 0, most + along)
        above, below = np.take_along_axis(profile, steps, axis=0)
        drop = (above - below) / np.maximum((steps[1] - steps[0]) * _CELL, 1e-9)
        slopes.append(np.rad2deg(np.arctan(np.maximum(drop, 0.0))))
        sides.append(last * _CELL)
        falls = [looked_up(slope, np.asarray(sign * last, np.intp)) for slope in gradient]
        aside = np.abs(falls[1] * step[0] - falls[0] * step[1])
        with np.errstate(invalid="ignore"):
            free &= aside <= _ASIDE * np.hypot(*falls)
    width = sides[0] + sides[1]
    steep = np.minimum(*slopes)
    good = free & (width >= _NARROWEST * grasping.opening) & (width <= grasping.opening)
    good &= np.abs(slopes[0] - slopes[1]) <= _UNEVEN
    with np.errstate(invalid="ignore"):
        good &= np.isfinite(steep) & (90.0 - steep <= grasping.steepest_back)
    return _Closed(np.where(good, 90.0 - steep, np.inf), width)
