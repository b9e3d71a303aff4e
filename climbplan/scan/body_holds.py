"""Graspable spots of closed bodies: faces beside which two fingers close on opposite sides.

A scan of a wall is a relief (`climbplan.scan.holds`); bodies that stand alone, such as cubes, beams
and stones, have no wall. There the palm comes to one of the contact regions that are found in the
mesh, and the fingers, which reach a depth below it, close along an axis t in it. Along the line of
the grip they come in from the opening until they touch the raw triangles. Both have to touch an
outside, that faces along t within some degrees; its undercut u is that of a normal
+-cos(u) t - sin(u) n. On their way in nothing else may be met. Where a grip's centre may be is the
largest rectangle in which all of that holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from climbplan.arrays import Array, BoolArray
from climbplan.scan.cleaning import components, open_edges
from climbplan.scan.fitting import FoundRegion, found_regions
from climbplan.scan.holds import Grasping
from climbplan.scan.panels import HEADROOM, Frame
from climbplan.scan.raw import RawScan, ScanError, chosen
from climbplan.scan.triangles import first_met
from climbplan.schema.terrain.scan import ScanSpec

_CELL = 2.5e-3  # [m] between places at which a grip is tried
_COARSE = 1e-2  # [m] the same across the fingers, while their direction is looked for
_STEPS = 12  # directions of fingers in half a turn, beside those of the region's edges
_APART = np.deg2rad(40.0)  # between the axes of two holds of one region
_ALIKE = np.deg2rad(3.0)  # between axes that are tried
_ASIDE = np.sin(np.deg2rad(25.0))  # of the angle by which a side may face away from the axis
_UNEVEN = np.deg2rad(25.0)  # by which both sides may differ
_NARROWEST = 0.3  # of the opening: fingers hold nothing thinner
_DIGITS = 9  # of a spec's corners [m] and directions, so that regions stay flat
_ROUNDED = 4.9e-3  # [deg] by which an undercut is told smaller, not larger
NAME = "scan"  # of regions found in a scan, with a number
_FREE = 1e-3  # [m] that an open finger has beside what it closes on


@dataclass(frozen=True)
class BodyHold:
    """Where a palm may be on a face, and how the sides beside it are gripped."""

    vertices: Array  # (4, 3) of the rectangle for the grip's centre, anticlockwise [m]
    normal: Array  # (3,) unit, into free space
    axis: Array  # (3,) unit: from one finger to the other
    undercut_deg: float  # of the side that leans back most
    width: float  # [m] between the gripped sides, at most
    label: str  # material or colour in the file


def bodies(raw: RawScan) -> BoolArray:
    """(T,) triangles of closed bodies, which end at no edge but may touch others."""
    if not len(raw.triangles):
        return np.zeros(0, bool)
    surface = components(raw.triangles)
    is_open = open_edges(raw.triangles).any(axis=1)
    return np.asarray(np.bincount(surface, weights=is_open)[surface] == 0)


def body_holds(raw: RawScan, scan: ScanSpec, grasping: Grasping) -> tuple[BodyHold, ...]:
    """What a gripper can hold on the closed bodies of a mesh, largest regions first.

    Raises ScanError where there is nothing.
    """
    alone = chosen(raw, bodies(raw))
    regions = [r for r in found_regions(raw, scan) if _on(alone, r)]
    found = [hold for region in regions for hold in _holds_of(region, raw.corners, grasping)]
    if not found:
        raise ScanError(
            f"no graspable spot on the closed bodies of the mesh: of their {len(regions)} contact "
            f"regions none has two sides within the gripper's opening of "
            f"{1e3 * grasping.opening:.0f} mm that go {1e3 * grasping.depth:.0f} mm down, lean "
            f"back by at most {grasping.steepest_back:.0f} degrees and have room for fingers"
        )
    return tuple(found)


def body_headline(holds: Sequence[BodyHold], grasping: Grasping) -> str:
    """What was found, in a line."""
    backs = [-hold.undercut_deg for hold in holds]
    lean = f"leaning back by at most {max(max(backs), 0.0):.0f} degrees"
    return (
        f"{len(holds)} graspable spots of closed bodies within an opening of "
        f"{1e3 * grasping.opening:.0f} mm, {1e3 * grasping.depth:.0f} mm deep, sides {lean}"
    )


def body_regions(holds: Sequence[BodyHold], scan: ScanSpec) -> list[dict[str, object]]:
    """The holds as `terrain.regions` of a spec, numbered."""
    out: list[dict[str, object]] = []
    for number, hold in enumerate(holds, start=1):
        own: dict[str, object] = {
            "name": f"{NAME} {number}",
            "vertices": np.round(hold.vertices, _DIGITS).tolist(),
        }
        if hold.label in scan.friction:
            own["friction"] = scan.friction[hold.label]
        undercut = round(hold.undercut_deg - _ROUNDED, 2) + 0.0
        own["hold"] = {"axis": np.round(hold.axis, _DIGITS).tolist(), "undercut_deg": undercut}
        out.append(own)
    return out


def _on(alone: RawScan, region: FoundRegion) -> bool:
    """Whether a region lies on one of the bodies."""
    middle, normal = region.middle, region.normal
    above = np.ascontiguousarray(middle[None] + _CELL * normal)
    return bool(first_met(above, -normal, alone.corners, 2 * _CELL)[1][0] >= 0)


def _holds_of(region: FoundRegion, corners: Array, grasping: Grasping) -> list[BodyHold]:
    """One hold for each direction of fingers that does, the steepest sides first."""
    reach = grasping.opening / 2 + HEADROOM
    low, high = region.vertices.min(axis=0) - reach, region.vertices.max(axis=0) + reach
    near = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    corners = np.ascontiguousarray(corners[near.all(axis=1)])
    tried = [_hold(region, axis, corners, grasping, _COARSE) for axis in _axes(region)]
    good = [t for t in tried if t is not None]
    good.sort(key=lambda t: (-round(t[0].undercut_deg, 1), round(t[1], 3)))
    kept: list[BodyHold] = []
    for rough, _ in good:
        if all(abs(float(rough.axis @ k.axis)) < np.cos(_APART) for k in kept):
            exact = _hold(region, rough.axis, corners, grasping, _CELL)
            kept.append(exact[0] if exact is not None else rough)
    return kept


def _axes(region: FoundRegion) -> list[Array]:
    """Directions of fingers in the plane of a region: across its edges, then all around."""
    frame = Frame.on(region.normal, float(region.normal @ region.vertices[0]))
    edges = np.roll(region.vertices, -1, axis=0) - region.vertices
    out = np.cross(edges, region.normal)
    out = out[np.argsort(-np.linalg.norm(out, axis=1), kind="stable")]
    angle = np.pi * np.arange(_STEPS) / _STEPS
    around = np.cos(angle)[:, None] * frame.along + np.sin(angle)[:, None] * frame.across
    kept: list[Array] = []
    for axis in (*out, *around):
        unit = axis / np.linalg.norm(axis)
        if all(abs(float(unit @ k)) < np.cos(_ALIKE) for k in kept):
            kept.append(np.asarray(unit))
    return kept


def _hold(
    region: FoundRegion, axis: Array, corners: Array, grasping: Grasping, across: float
) -> tuple[BodyHold, float] | None:
    """The hold of one direction of fingers, and how far its sides face away from it.

    across: [m] between places that are tried, at right angles to the fingers.
    """
    normal = region.normal
    other = np.cross(normal, axis)
    middle = region.middle
    own = (region.vertices - middle) @ np.stack([axis, other]).T
    inside = shapely.Polygon(own).buffer(1e-9)
    cells = (_CELL, across)
    ends = zip(cells, own.min(axis=0), own.max(axis=0), strict=True)
    lines = [np.arange(np.ceil(a / cell), b / cell) * cell for cell, a, b in ends]
    if not all(len(line) for line in lines):
        return None
    u, v = (grid.ravel() for grid in np.meshgrid(*lines, indexing="ij"))
    shape = tuple(len(line) for line in lines)
    good = shapely.contains_xy(inside, u, v)
    places = middle + u[:, None] * axis + v[:, None] * other
    sides = [_touched(places, sign * axis, normal, corners, grasping) for sign in (1.0, -1.0)]
    width = sides[0].way + sides[1].way
    with np.errstate(invalid="ignore"):
        good &= sides[0].free & sides[1].free & (width >= _NARROWEST * grasping.opening)
        good &= np.abs(sides[0].undercut - sides[1].undercut) <= _UNEVEN
        undercut = np.minimum(sides[0].undercut, sides[1].undercut)
        good &= undercut >= -np.deg2rad(grasping.steepest_back)
    corner = _largest_rectangle(good.reshape(shape))
    if corner is None:
        return None
    (first, last), (lower, upper) = corner
    part = np.zeros(shape, bool)
    part[first : last + 1, lower : upper + 1] = True
    part = part.ravel()
    room = [(lines[0][first], lines[0][last]), (lines[1][lower], lines[1][upper])]
    room = [(a, b) if b > a else (a - _CELL / 4, b + _CELL / 4) for a, b in room]
    (u0, u1), (v0, v1) = room
    vertices = np.array(
        [middle + a * axis + b * other for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]
    )
    aside = float(np.maximum(sides[0].aside, sides[1].aside)[part].max())
    steepest = float(np.rad2deg(undercut[part].min()))
    hold = BodyHold(vertices, normal, axis, steepest, float(width[part].max()), region.label)
    return hold, aside


@dataclass(frozen=True)
class _Side:
    """What one finger touches, for P places of the grip's centre."""

    free: BoolArray  # (P,) it comes in and touches an outside
    way: Array  # (P,) [m] from the grip's centre to where
    undercut: Array  # (P,) [rad]
    aside: Array  # (P,) sine of the angle by which the side faces away


def _touched(
    places: Array, axis: Array, normal: Array, corners: Array, grasping: Grasping
) -> _Side:
    """Coming in against `axis` from half of the opening, a depth below the places."""
    half = grasping.opening / 2
    outer = places + half * axis - grasping.depth * normal
    inward, number = first_met(outer, -axis, corners, grasping.opening)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faced = (doubled / np.maximum(np.linalg.norm(doubled, axis=1), 1e-15)[:, None])[number]
    out, over = faced @ axis, faced @ normal
    aside = np.abs(faced @ np.cross(normal, axis))
    # The open finger comes down beside it, and is free where it stays open
    above = first_met(outer - _FREE * normal, normal, corners, grasping.depth + HEADROOM)[1]
    free = (inward < half) & (out > 0) & (aside <= _ASIDE) & (above < 0)
    way = np.where(free, half - inward, np.nan)
    return _Side(np.asarray(free), way, np.arctan2(-over, out), aside)


def _largest_rectangle(good: BoolArray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """First and last rows and columns of the largest rectangle of good cells; None for none."""
    best, found = 0, None
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
                    found = ((row - low + 1, row), (first, last))
    return found
