"""Graspable spots of a scanned wall: where two fingers close on what protrudes from its plane.

The wall is the plane that most points lie in; the scan is a relief over it, z = h(u, v), in cells
of a few millimetres. Fingers close along an axis t and reach a depth below the surface at the
centre of the grip. Each comes in from the gripper's opening until it touches the relief. The slope
of the relief there is that of the gripped side, with normal +-cos(u) t - sin(u) n and undercut u as
in `climbplan.terrain.holds`: 0 for a side at right angles to the wall, below 0 for one that leans
back. A relief is seen from the front and shows no sides that are undercut (u > 0).

Holds are ranked by the steepness of their sides; those within a hold's size of a better one are
left out. The centre of a grip may be anywhere in the square about it in which grips of the same
axis hold as well.
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
_PLANE_TOLERANCE = 6e-3  # [m] of points from the wall's plane
_NUM_PASSES = 20
_NUM_DIRECTIONS = 12  # of fingers in half a turn
_FINGER_CLEARANCE = 4e-3  # [m] of an open finger's tip above the relief
_SLOPE_RADIUS = 2.5e-3  # [m] about a contact, over which the slope is taken
_MAX_SKEW = np.sin(np.deg2rad(25.0))  # of the normal of a side from the axis
_MIN_WIDTH_RATIO = 0.3  # of what is gripped, over the opening
_MIN_DISTANCE_RATIO = 0.8  # between the centres of two grips, over the opening
_MAX_ASYMMETRY = 25.0  # [deg] between the slopes of both sides
_MAX_ROOM = 6  # cells from the middle


@dataclass(frozen=True)
class Grasping:
    """The requirements of a gripper on a hold."""

    opening: float  # [m] between its open fingers
    depth: float = 0.015  # [m] that fingers reach beside what they grip
    steepest_back: float = 45.0  # [deg] that a side may lean back at most


@dataclass(frozen=True)
class FoundHold:
    """A position at which a gripper closes."""

    at: tuple[float, float]  # [m] across the wall and up it
    rise: float  # [m] of the gripped sides before the wall's plane
    axis_deg: float  # from `up` towards `across`
    undercut_deg: float  # of the side that leans back most
    width: float  # [m] between the gripped sides
    room: float  # [m] across and up in which the grip's centre may be


@dataclass(frozen=True)
class Wall:
    """The plane of a scanned wall, and its holds."""

    center: Array  # (3,) a point of it, world [m]
    across: Array  # (3,) unit, level
    up: Array  # (3,) unit
    normal: Array  # (3,) unit, into free space
    extent: tuple[tuple[float, float], tuple[float, float]]  # across and up, from and to [m]
    holds: tuple[FoundHold, ...]  # steepest sides first

    @property
    def angle_deg(self) -> float:
        """The angle as that of a panel: 90 upright, above: overhanging."""
        return float(np.rad2deg(np.arccos(np.clip(self.normal[2], -1.0, 1.0))))

    @property
    def turn_deg(self) -> float:
        """The rotation about z of a panel, which faces -y, to stand as the wall does."""
        return float(np.rad2deg(np.arctan2(self.across[1], self.across[0])))


def find_wall_holds(scan: RawScan, grasping: Grasping) -> Wall:
    """Find the wall of a scan and its holds.

    Args:
        scan: The scan.
        grasping: The gripper.

    Raises:
        ScanError: There is no wall or no hold.
    """
    points = scan.vertices
    center, normal = _fit_wall_plane(points, scan)
    across = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(across) < 1e-3:
        across = np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    local = (points - center) @ np.stack([across, up, normal]).T
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    u, v = (np.arange(a, b, _CELL) for a, b in zip(low, high, strict=True))
    grid_u, grid_v = np.meshgrid(u, v, indexing="ij")
    height = LinearNDInterpolator(local[:, :2], local[:, 2])(grid_u, grid_v)
    is_known = np.isfinite(height)
    height = ndimage.gaussian_filter(np.where(is_known, height, 0.0), 1.0)
    height = np.where(is_known, height, np.nan)
    grips = _select_grips(height, grasping)
    holds = tuple(
        FoundHold(
            at=(float(u[g.row]), float(v[g.column])),
            rise=g.rise,
            axis_deg=180.0 / _NUM_DIRECTIONS * g.turn,
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


def _fit_wall_plane(points: Array, scan: RawScan) -> tuple[Array, Array]:
    """Return a point and the normal of the plane that most points lie in.

    The normal faces as the scan does.
    """
    is_inlier: BoolArray = np.ones(len(points), bool)
    center, normal = points.mean(axis=0), np.zeros(3)
    for _ in range(_NUM_PASSES):
        center = points[is_inlier].mean(axis=0)
        offset = points[is_inlier] - center
        normal = np.linalg.eigh(offset.T @ offset)[1][:, 0]  # across which points spread least
        distance = (points - center) @ normal
        is_inlier = np.abs(distance - np.median(distance[is_inlier])) <= _PLANE_TOLERANCE
        if is_inlier.sum() < 10:
            raise ScanError("no wall in the scan: no plane that its points lie in")
    if len(scan.triangles):
        corners = scan.corners
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
        normal = normal * (np.sign(float(facing @ normal)) or 1.0)
    return center, np.asarray(normal)


@dataclass(frozen=True)
class _Grip:
    """A grip at a cell of the relief."""

    row: int
    column: int
    turn: int  # of _NUM_DIRECTIONS
    back: float  # [deg] that the sides lean back
    width: float  # [m]
    rise: float  # [m]
    room: float  # [m]


@dataclass(frozen=True)
class _ClosedFingers:
    """The contact of fingers closed along one axis at every cell (U, V)."""

    back: Array  # [deg] that the side which leans back most does; infinite for no grip
    width: Array  # [m]


def _select_grips(height: Array, grasping: Grasping) -> list[_Grip]:
    """Return the best grips, none within most of an opening of a better one."""
    closed = [_close_fingers(height, grasping, k) for k in range(_NUM_DIRECTIONS)]
    back = np.stack([c.back for c in closed])  # (T, U, V)
    best = back.argmin(axis=0)
    min_back = back.min(axis=0)
    # Rounded, so that equal slopes keep their order
    order = np.argsort(np.round(min_back, 1), axis=None, kind="stable")
    grips: list[_Grip] = []
    min_distance = _MIN_DISTANCE_RATIO * grasping.opening / _CELL
    for place in order:
        row, column = (int(i) for i in np.unravel_index(place, min_back.shape))
        if not np.isfinite(min_back[row, column]):
            break
        if any(np.hypot(g.row - row, g.column - column) < min_distance for g in grips):
            continue
        turn = int(best[row, column])
        grips.append(
            _Grip(
                row,
                column,
                turn,
                float(min_back[row, column]),
                float(closed[turn].width[row, column]),
                float(height[row, column] - grasping.depth),
                _measure_room(back[turn], row, column, grasping.steepest_back),
            )
        )
    return grips


def _measure_room(back: Array, row: int, column: int, limit: float) -> float:
    """Return the side of the largest square about a cell in which all grips hold [m]."""
    for size in range(1, _MAX_ROOM + 1):
        rows, columns = slice(row - size, row + size + 1), slice(column - size, column + size + 1)
        neighbourhood = back[max(rows.start, 0) : rows.stop, max(columns.start, 0) : columns.stop]
        if neighbourhood.size < (2 * size + 1) ** 2 or (neighbourhood > limit).any():
            return (2 * size - 1) * _CELL
    return (2 * _MAX_ROOM + 1) * _CELL


def _close_fingers(height: Array, grasping: Grasping, turn: int) -> _ClosedFingers:
    """Close fingers along an axis, from `up` (columns) towards `across` (rows)."""
    angle = np.pi * turn / _NUM_DIRECTIONS
    step = np.array([np.sin(angle), np.cos(angle)])  # cells a step, rows and columns
    max_steps = int(np.floor(grasping.opening / 2 / _CELL))
    margin = int(np.ceil(_SLOPE_RADIUS / _CELL))
    rows, columns = np.indices(height.shape)

    def sample_heights(distance: float) -> Array:
        """Return heights that many cells along the axis; NaN outside the scan."""
        where = [rows + distance * step[0], columns + distance * step[1]]
        return np.asarray(
            ndimage.map_coordinates(height, where, order=1, cval=np.nan, prefilter=False)
        )

    def sample_values(values: Array, distance: NDArray[np.intp]) -> Array:
        """Return values that many cells along the axis, different for each cell."""
        where = [rows + distance * step[0], columns + distance * step[1]]
        return np.asarray(ndimage.map_coordinates(values, where, order=1, cval=np.nan))

    gradient: list[Array] = list(np.gradient(height, _CELL))
    grip = height - grasping.depth  # where fingers touch
    sides, slopes, free = [], [], np.ones(height.shape, bool)
    for sign in (1, -1):
        profile = np.stack(
            [sample_heights(sign * k) for k in range(max_steps + margin + 1)]
        )  # (K, U, V)
        with np.errstate(invalid="ignore"):
            free &= profile[max_steps] <= grip - _FINGER_CLEARANCE  # an open finger is free
            inside = profile[: max_steps + 1] >= grip
        # From the opening inwards: the last cell that blocks the finger
        last = max_steps - np.argmax(inside[::-1], axis=0)
        steps = np.clip(np.stack([last - margin, last + margin]), 0, max_steps + margin)
        above, below = np.take_along_axis(profile, steps, axis=0)
        drop = (above - below) / np.maximum((steps[1] - steps[0]) * _CELL, 1e-9)
        slopes.append(np.rad2deg(np.arctan(np.maximum(drop, 0.0))))
        sides.append(last * _CELL)
        falls = [sample_values(slope, np.asarray(sign * last, np.intp)) for slope in gradient]
        skew = np.abs(falls[1] * step[0] - falls[0] * step[1])
        with np.errstate(invalid="ignore"):
            free &= skew <= _MAX_SKEW * np.hypot(*falls)
    width = sides[0] + sides[1]
    steep = np.minimum(*slopes)
    good = free & (width >= _MIN_WIDTH_RATIO * grasping.opening) & (width <= grasping.opening)
    good &= np.abs(slopes[0] - slopes[1]) <= _MAX_ASYMMETRY
    with np.errstate(invalid="ignore"):
        good &= np.isfinite(steep) & (90.0 - steep <= grasping.steepest_back)
    return _ClosedFingers(np.where(good, 90.0 - steep, np.inf), width)
