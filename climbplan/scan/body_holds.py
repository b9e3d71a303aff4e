"""Graspable spots of closed bodies: faces beside which two fingers close on opposite sides.

A scan of a wall is a relief (`climbplan.scan.holds`). Bodies that stand alone, such as cubes, beams
and stones, have no wall. There the palm comes to one of the contact regions of the mesh. The
fingers reach a depth below it and close along an axis t in it, from the opening until they touch
the raw triangles. Both have to touch an outside that faces along t within some degrees; its
undercut u is that of a normal +-cos(u) t - sin(u) n. Their approach has to be free. The centre of a
grip may be anywhere in the largest rectangle in which all of that holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from climbplan.arrays import Array, BoolArray
from climbplan.scan.cleaning import find_components, find_open_edges
from climbplan.scan.contact_regions import FoundRegion, find_contact_regions
from climbplan.scan.holds import Grasping
from climbplan.scan.raw import RawScan, ScanError, select_triangles
from climbplan.scan.steppable_regions import HEADROOM, PlaneFrame
from climbplan.scan.triangles import cast_rays
from climbplan.schema.terrain.scan import ScanSpec

_CELL = 2.5e-3  # [m] between centres at which a grip is tried
_COARSE = 1e-2  # [m] the same across the fingers, in the search for their direction
_NUM_DIRECTIONS = 12  # of fingers in half a turn, in addition to the region's edges
_MIN_AXIS_ANGLE = np.deg2rad(40.0)  # between the axes of two holds of one region
_SAME_AXIS = np.deg2rad(3.0)  # between axes that are tried
_MAX_SKEW = np.sin(np.deg2rad(25.0))  # of the normal of a side from the axis
_MAX_ASYMMETRY = np.deg2rad(25.0)  # between the undercuts of both sides
_MIN_WIDTH_RATIO = 0.3  # of what is gripped, over the opening
_DIGITS = 9  # of a spec's corners [m] and directions, so that regions stay flat
_UNDERCUT_MARGIN = 4.9e-3  # [deg] so that an undercut is rounded down
NAME = "scan"  # of regions found in a scan, with a number
_FINGER_CLEARANCE = 1e-3  # [m] of an open finger from what it closes on


@dataclass(frozen=True)
class BodyHold:
    """The positions of a palm on a face, and how the sides next to it are gripped."""

    vertices: Array  # (4, 3) of the rectangle for the grip's centre, anticlockwise [m]
    normal: Array  # (3,) unit, into free space
    axis: Array  # (3,) unit: from one finger to the other
    undercut_deg: float  # of the side that leans back most
    width: float  # [m] between the gripped sides, at most
    label: str  # material or colour in the file


def find_closed_bodies(raw: RawScan) -> BoolArray:
    """Return the triangles (T,) of closed bodies, which end at no edge but may touch others."""
    if not len(raw.triangles):
        return np.zeros(0, bool)
    surface = find_components(raw.triangles)
    is_open = find_open_edges(raw.triangles).any(axis=1)
    return np.asarray(np.bincount(surface, weights=is_open)[surface] == 0)


def find_body_holds(raw: RawScan, scan: ScanSpec, grasping: Grasping) -> tuple[BodyHold, ...]:
    """Find the holds of a gripper on the closed bodies of a mesh, largest regions first.

    Args:
        raw: The mesh.
        scan: Its keys.
        grasping: The gripper.

    Raises:
        ScanError: There is no hold.
    """
    alone = select_triangles(raw, find_closed_bodies(raw))
    regions = [r for r in find_contact_regions(raw, scan) if _lies_on_body(alone, r)]
    holds = [
        hold for region in regions for hold in _find_region_holds(region, raw.corners, grasping)
    ]
    if not holds:
        raise ScanError(
            f"no graspable spot on the closed bodies of the mesh: of their {len(regions)} contact "
            f"regions none has two sides within the gripper's opening of "
            f"{1e3 * grasping.opening:.0f} mm that go {1e3 * grasping.depth:.0f} mm down, lean "
            f"back by at most {grasping.steepest_back:.0f} degrees and have room for fingers"
        )
    return tuple(holds)


def format_body_summary(holds: Sequence[BodyHold], grasping: Grasping) -> str:
    """Return a one-line summary of the holds."""
    backs = [-hold.undercut_deg for hold in holds]
    lean = f"leaning back by at most {max(max(backs), 0.0):.0f} degrees"
    return (
        f"{len(holds)} graspable spots of closed bodies within an opening of "
        f"{1e3 * grasping.opening:.0f} mm, {1e3 * grasping.depth:.0f} mm deep, sides {lean}"
    )


def format_body_regions(holds: Sequence[BodyHold], scan: ScanSpec) -> list[dict[str, object]]:
    """Return the holds as `terrain.regions` of a spec, numbered."""
    regions: list[dict[str, object]] = []
    for number, hold in enumerate(holds, start=1):
        region: dict[str, object] = {
            "name": f"{NAME} {number}",
            "vertices": np.round(hold.vertices, _DIGITS).tolist(),
        }
        if hold.label in scan.friction:
            region["friction"] = scan.friction[hold.label]
        undercut = round(hold.undercut_deg - _UNDERCUT_MARGIN, 2) + 0.0
        region["hold"] = {"axis": np.round(hold.axis, _DIGITS).tolist(), "undercut_deg": undercut}
        regions.append(region)
    return regions


def _lies_on_body(alone: RawScan, region: FoundRegion) -> bool:
    """Return whether a region lies on one of the bodies."""
    middle, normal = region.middle, region.normal
    above = np.ascontiguousarray(middle[None] + _CELL * normal)
    return bool(cast_rays(above, -normal, alone.corners, 2 * _CELL)[1][0] >= 0)


def _find_region_holds(region: FoundRegion, corners: Array, grasping: Grasping) -> list[BodyHold]:
    """Return one hold for each suitable direction of fingers, the steepest sides first."""
    reach = grasping.opening / 2 + HEADROOM
    low, high = region.vertices.min(axis=0) - reach, region.vertices.max(axis=0) + reach
    is_near = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    corners = np.ascontiguousarray(corners[is_near.all(axis=1)])
    tried = [_build_hold(region, axis, corners, grasping, _COARSE) for axis in _list_axes(region)]
    good = [t for t in tried if t is not None]
    good.sort(key=lambda t: (-round(t[0].undercut_deg, 1), round(t[1], 3)))
    holds: list[BodyHold] = []
    for rough, _ in good:
        if all(
            abs(float(rough.axis @ accepted.axis)) < np.cos(_MIN_AXIS_ANGLE) for accepted in holds
        ):
            exact = _build_hold(region, rough.axis, corners, grasping, _CELL)
            holds.append(exact[0] if exact is not None else rough)
    return holds


def _list_axes(region: FoundRegion) -> list[Array]:
    """Return directions of fingers in the plane of a region: across its edges, then all around."""
    frame = PlaneFrame.on(region.normal, float(region.normal @ region.vertices[0]))
    edges = np.roll(region.vertices, -1, axis=0) - region.vertices
    directions = np.cross(edges, region.normal)
    directions = directions[np.argsort(-np.linalg.norm(directions, axis=1), kind="stable")]
    angle = np.pi * np.arange(_NUM_DIRECTIONS) / _NUM_DIRECTIONS
    around = np.cos(angle)[:, None] * frame.along + np.sin(angle)[:, None] * frame.across
    axes: list[Array] = []
    for axis in (*directions, *around):
        unit = axis / np.linalg.norm(axis)
        if all(abs(float(unit @ k)) < np.cos(_SAME_AXIS) for k in axes):
            axes.append(np.asarray(unit))
    return axes


def _build_hold(
    region: FoundRegion, axis: Array, corners: Array, grasping: Grasping, across: float
) -> tuple[BodyHold, float] | None:
    """Return the hold of one direction of fingers, and the skew of its sides.

    None if there is none. across: distance between tried centres at right angles to the fingers
    [m].
    """
    normal = region.normal
    lateral = np.cross(normal, axis)
    middle = region.middle
    local = (region.vertices - middle) @ np.stack([axis, lateral]).T
    polygon = shapely.Polygon(local).buffer(1e-9)
    cells = (_CELL, across)
    ends = zip(cells, local.min(axis=0), local.max(axis=0), strict=True)
    lines = [np.arange(np.ceil(a / cell), b / cell) * cell for cell, a, b in ends]
    if not all(len(line) for line in lines):
        return None
    u, v = (grid.ravel() for grid in np.meshgrid(*lines, indexing="ij"))
    shape = tuple(len(line) for line in lines)
    good = shapely.contains_xy(polygon, u, v)
    places = middle + u[:, None] * axis + v[:, None] * lateral
    sides = [_close_finger(places, sign * axis, normal, corners, grasping) for sign in (1.0, -1.0)]
    width = sides[0].distance + sides[1].distance
    with np.errstate(invalid="ignore"):
        good &= sides[0].free & sides[1].free & (width >= _MIN_WIDTH_RATIO * grasping.opening)
        good &= np.abs(sides[0].undercut - sides[1].undercut) <= _MAX_ASYMMETRY
        undercut = np.minimum(sides[0].undercut, sides[1].undercut)
        good &= undercut >= -np.deg2rad(grasping.steepest_back)
    corner = _find_largest_rectangle(good.reshape(shape))
    if corner is None:
        return None
    (first, last), (lower, upper) = corner
    is_selected = np.zeros(shape, bool)
    is_selected[first : last + 1, lower : upper + 1] = True
    is_selected = is_selected.ravel()
    ranges = [(lines[0][first], lines[0][last]), (lines[1][lower], lines[1][upper])]
    ranges = [(a, b) if b > a else (a - _CELL / 4, b + _CELL / 4) for a, b in ranges]
    (u0, u1), (v0, v1) = ranges
    vertices = np.array(
        [middle + a * axis + b * lateral for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]
    )
    skew = float(np.maximum(sides[0].skew, sides[1].skew)[is_selected].max())
    steepest = float(np.rad2deg(undercut[is_selected].min()))
    hold = BodyHold(vertices, normal, axis, steepest, float(width[is_selected].max()), region.label)
    return hold, skew


@dataclass(frozen=True)
class _Side:
    """The contact of one finger, for P centres of the grip."""

    free: BoolArray  # (P,) the finger comes in and touches an outside
    distance: Array  # (P,) [m] from the grip's centre to the contact
    undercut: Array  # (P,) [rad]
    skew: Array  # (P,) sine of the angle between the side's normal and the axis


def _close_finger(
    places: Array, axis: Array, normal: Array, corners: Array, grasping: Grasping
) -> _Side:
    """Move a finger against `axis` from half of the opening, a depth below the centres."""
    half = grasping.opening / 2
    outer = places + half * axis - grasping.depth * normal
    inward, number = cast_rays(outer, -axis, corners, grasping.opening)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faced = (doubled / np.maximum(np.linalg.norm(doubled, axis=1), 1e-15)[:, None])[number]
    along_axis, along_normal = faced @ axis, faced @ normal
    skew = np.abs(faced @ np.cross(normal, axis))
    # The open finger comes down next to the side, free where it stays open
    above = cast_rays(
        outer - _FINGER_CLEARANCE * normal, normal, corners, grasping.depth + HEADROOM
    )[1]
    free = (inward < half) & (along_axis > 0) & (skew <= _MAX_SKEW) & (above < 0)
    distance = np.where(free, half - inward, np.nan)
    return _Side(np.asarray(free), distance, np.arctan2(-along_normal, along_axis), skew)


def _find_largest_rectangle(good: BoolArray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Return first and last rows and columns of the largest rectangle of good cells.

    None without good cells.
    """
    best, rectangle = 0, None
    height = np.zeros(good.shape[1], np.int64)
    for row in range(len(good)):
        height = np.where(good[row], height + 1, 0)
        for first in range(len(height)):
            low = int(height[first])
            for last in range(first, len(height)):
                low = min(low, int(height[last]))
                if low == 0:
                    break
                if low * (last - first + 1) > best:
                    best = low * (last - first + 1)
                    rectangle = ((row - low + 1, row), (first, last))
    return rectangle
