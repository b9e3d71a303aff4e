"""Ground that a robot walks on: flat without end, or convex regions, level or sloped.

Terrain of climbs is read as well: regions as `rectangle` or `vertices`, `ground`, `boxes`, `scan`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Self

from pydantic import Field, model_validator

from climbplan.schema.base import (
    Count,
    Fault,
    Interval,
    Number,
    SpecModel,
    Vector,
    name_field,
    quantity,
    refuse,
)
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.schema.terrain.shapes import check_polygon
from climbplan.schema.terrain.terrain import BoxSpec, GroundSpec, RectangleSpec
from climbplan.walking.schema.region_plane import (
    RegionPlane,
    is_axis_aligned,
    list_rectangle_corners,
    read_polygon_plane,
)

Pair = tuple[Number, Number]
_PLANE = 1e-4  # [m] that corners may be off one plane
_STEEPEST = 1.0  # rise along x or y: 45 degrees
_MOST_CORNERS = 12


class LevelRegionSpec(SpecModel):
    """A convex region that toes may stand on, level or sloped.

    It is a rectangle by `x`, `y`, `height` and `slope`, a polygon by `corners`, or has the form of
    climbs: `rectangle` or `vertices`.
    """

    name: str = name_field("name used in reports")
    x: Interval = quantity(
        "m", "extent along x, from and to; of corners if these are given", (0, 0)
    )
    y: Interval = quantity(
        "m", "extent along y, from and to; of corners if these are given", (0, 0)
    )
    height: Number = quantity("m", "height of the surface, at the middle if it slopes", default=0.0)
    slope: Pair = quantity("", "rise of a rectangle for each metre along x and y", (0.0, 0.0))
    corners: tuple[Vector, ...] = quantity(
        "m", "x, y, z of the corners of a convex polygon in turn, in place of all of these", ()
    )
    rectangle: RectangleSpec | None = Field(
        default=None, description="the region as a rectangle, as in climbs"
    )
    vertices: tuple[Vector, ...] | None = quantity(
        "m", "corners of a convex polygon, anticlockwise seen from above, as in climbs", None
    )
    friction: Number | None = quantity(
        "", "friction coefficient; `terrain.friction` if left out", default=None, gt=0, le=5
    )
    limbs: tuple[str, ...] | None = Field(
        default=None, description="legs that may stand on the region; all if left out"
    )

    @model_validator(mode="after")
    def _extents(self) -> Self:
        if self.rectangle is not None or self.vertices is not None:
            refuse(self._climb_faults())
            return self
        if self.corners:
            refuse(self._corner_faults())
            return self
        faults = [
            Fault(key, f"expected [from, to] with from < to, got {list(interval)}")
            for key, interval in (("x", self.x), ("y", self.y))
            if interval[0] >= interval[1]
        ]
        if max(map(abs, self.slope)) > _STEEPEST:
            message = f"expected a rise of {_STEEPEST:g} at most either way, got {list(self.slope)}"
            faults.append(Fault("slope", message))
        refuse(faults)
        return self

    def _climb_faults(self) -> list[Fault]:
        """Return what is wrong with a region in the form of climbs."""
        form = "rectangle" if self.rectangle is not None else "vertices"
        forms = ("x", "y", "height", "slope", "corners", "vertices")
        second_forms = [key for key in forms if key != form and key in self.model_fields_set]
        if second_forms:
            return [
                Fault(key, f"expected either `{form}` or `{key}`, got both") for key in second_forms
            ]
        if self.vertices is not None and (fault := check_polygon(self.vertices)):
            return [Fault("vertices", fault)]
        plane = read_polygon_plane(self._list_vertices())
        if plane is None:
            return [
                Fault(
                    form,
                    "expected a region that faces up, to be walked on: its normal points "
                    + (
                        "down or level; vertices run anticlockwise seen from above"
                        if form == "vertices"
                        else "down or level"
                    ),
                )
            ]
        if max(map(abs, plane.slope)) > _STEEPEST:
            rise = max(map(abs, plane.slope))
            return [Fault(form, f"expected a rise of {_STEEPEST:g} at most, got {rise:.2f}")]
        return []

    def _list_vertices(self) -> tuple[Vector, ...]:
        """Return the corners of a region in the form of climbs."""
        if self.rectangle is None:
            return self.vertices or ()
        shape = self.rectangle
        return list_rectangle_corners(shape.center, shape.normal, shape.width, shape.height)

    def _corner_faults(self) -> list[Fault]:
        both = [key for key in ("x", "y", "height", "slope") if key in self.model_fields_set]
        if both:
            return [
                Fault(key, "expected either `corners` or `x`, `y`, `height` and `slope`")
                for key in both
            ]
        if not 3 <= len(self.corners) <= _MOST_CORNERS:
            message = f"expected 3 to {_MOST_CORNERS} corners, got {len(self.corners)}"
            return [Fault("corners", message)]
        turns = [_cross_product(*self.corners_about(k)) for k in range(len(self.corners))]
        if not (min(turns) > 1e-9 or max(turns) < -1e-9):
            return [Fault("corners", "expected a convex polygon as seen from above, in turn")]
        rise = fit_slope(self.corners)
        if max(map(abs, rise)) > _STEEPEST:
            return [Fault("corners", f"expected a slope of at most {_STEEPEST:g}")]
        x, y, z = self.corners[0]
        off = [abs(z + rise[0] * (c[0] - x) + rise[1] * (c[1] - y) - c[2]) for c in self.corners]
        if max(off) > _PLANE:
            return [
                Fault(
                    "corners", f"expected corners in one plane, got {1e3 * max(off):.1f} mm off it"
                )
            ]
        return []

    def corners_about(self, k: int) -> tuple[Vector, Vector, Vector]:
        """A corner between the one before and the one after it."""
        return self.corners[k - 1], self.corners[k], self.corners[(k + 1) % len(self.corners)]

    @property
    def outline(self) -> tuple[Pair, ...]:
        """Corners seen from above, counterclockwise."""
        return self.plane.outline

    @property
    def plane(self) -> RegionPlane:
        """The outline seen from above, and the plane."""
        if self.rectangle is not None or self.vertices is not None:
            plane = read_polygon_plane(self._list_vertices())
            assert plane is not None  # as the region was validated
            return plane
        if not self.corners:
            (x0, x1), (y0, y1) = self.x, self.y
            middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1), self.height)
            return RegionPlane(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), self.slope, middle)
        corners_from_above = tuple((c[0], c[1]) for c in self.corners)
        is_counterclockwise = _cross_product(*self.corners_about(0)) > 0
        return RegionPlane(
            corners_from_above if is_counterclockwise else corners_from_above[::-1],
            fit_slope(self.corners),
            self.corners[0],
        )

    @property
    def is_rectangle(self) -> bool:
        """True if the outline is a rectangle along x and y."""
        return is_axis_aligned(self.plane.outline)


class SteppingStonesSpec(SpecModel):
    """A field of stones in rows, each turned, raised and left out at random."""

    x: Interval = quantity("m", "extent along x, from and to")
    y: Interval = quantity("m", "extent along y, from and to")
    pitch: Number = quantity("m", "from the middle of a stone to the next", 0.1, gt=0.01, le=1)
    size: Number = quantity("m", "length of a stone's sides", default=0.07, gt=0.005, le=1)
    turn_deg: Number = quantity("deg", "turned by as much at most", default=10.0, ge=0, le=45)
    rise: Number = quantity("m", "raised or lowered by as much at most", 0.0, ge=0, le=0.2)
    missing: Number = quantity("", "share of the stones that are missing", default=0.3, ge=0, lt=1)
    seed: Count = quantity("", "of turns, heights and what is missing", 0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        angle = math.radians(self.turn_deg)
        extent = self.size * (math.cos(angle) + math.sin(angle))
        faults = [
            Fault(key, f"expected [from, to] with room for a stone, got {list(interval)}")
            for key, interval in (("x", self.x), ("y", self.y))
            if interval[1] - interval[0] < extent
        ]
        if extent > self.pitch:
            message = f"turned stones of {self.size:g} m overlap at a pitch of {self.pitch:g} m"
            faults.append(Fault("size", message))
        refuse(faults)
        return self


class WalkTerrainSpec(SpecModel):
    """The ground: flat without end, or regions and stones, between which nothing stands."""

    friction: Number = quantity("", "friction coefficient", default=1.0, gt=0, le=5)
    regions: tuple[LevelRegionSpec, ...] = Field(
        default=(),
        description="rectangles and polygons, such as steps and ramps; flat ground if left out",
    )
    stones: SteppingStonesSpec | None = Field(
        default=None, description="a random field of stepping stones, S1, S2, ... in rows along y"
    )

    ground: GroundSpec | None = Field(
        default=None, description="level ground, as in climbs; none under `boxes`"
    )
    boxes: tuple[BoxSpec, ...] = Field(
        default=(), description="solid boxes whose tops legs may stand on, as in climbs"
    )
    scan: ScanSpec | None = Field(
        default=None,
        description="mesh, point cloud or height map of the terrain, as in climbs: what is flat "
        "and at most 45 degrees steep becomes regions",
    )
    edge: Number | None = quantity(
        "m",
        "no toe is set down so near to the edge of a region or stone; left out: the radius of the "
        "robot's feet, 0 of points, and 0 with a scan, whose regions keep `scan.toe_radius`",
        None,
        ge=0,
        le=0.2,
    )

    @property
    def has_footholds(self) -> bool:
        """True if the terrain is not flat without end."""
        stated = bool(self.regions or self.boxes) or self.ground is not None
        return stated or self.stones is not None or self.scan is not None

    @model_validator(mode="after")
    def _apart(self) -> Self:
        faults = [
            Fault(
                f"regions.{k}",
                f"expected a region wider than twice `terrain.edge`, {self.edge:g} m",
            )
            for k, region in enumerate(self.regions)
            if self.edge and not _has_interior(region.outline, self.edge)
        ]
        if self.stones is not None and self.stones.size <= 2 * (self.edge or 0.0):
            faults.append(
                Fault(
                    "edge", f"expected less than half of the size of stones, {self.stones.size:g} m"
                )
            )
        if self.scan is not None and self.scan.holds is not None:
            faults.append(Fault("scan.holds", "walks stand on their toes: expected no `holds`"))
        refuse([*faults, *self._name_faults(), *self._overlap_faults()])
        return self

    def _name_faults(self) -> Iterator[Fault]:
        """Yield names that several parts of the terrain have."""
        places = [("ground", "ground")] if self.ground is not None else []
        places += [(box.name, f"boxes.{k}.name") for k, box in enumerate(self.boxes)]
        places += [(region.name, f"regions.{k}.name") for k, region in enumerate(self.regions)]
        names: set[str] = set()
        for name, key in places:
            if name in names:
                yield Fault(key, f"names must differ, {name!r} is there already")
            names.add(name)
            if self.stones is not None and name[:1] == "S" and name[1:].isdigit():
                yield Fault(key, "S1, S2, ... are names of the stones")

    def _overlap_faults(self) -> Iterator[Fault]:
        """Yield parts of the terrain that overlap as seen from above; those of scans may."""
        if self.scan is not None:
            return
        outlines = [(f"regions.{k}", r.name, r.outline) for k, r in enumerate(self.regions)]
        for k, box in enumerate(self.boxes):
            (x0, y0, _), (x1, y1, _) = box.lower, box.upper
            outlines.append((f"boxes.{k}", box.name, _list_rectangle((x0, x1), (y0, y1))))
        for i, (key, _, outline) in enumerate(outlines):
            for _, earlier, earlier_outline in outlines[:i]:
                if polygons_overlap(outline, earlier_outline):
                    yield Fault(key, f"overlaps region {earlier!r}")
        if self.ground is not None:
            level = _list_rectangle(self.ground.across, self.ground.along)
            for k, region in enumerate(self.regions):
                if polygons_overlap(region.outline, level):
                    yield Fault(f"regions.{k}", "overlaps `ground`; expected `boxes` on it")
            outlines.append(("ground", "ground", level))
        field = None if self.stones is None else _list_rectangle(self.stones.x, self.stones.y)
        for _, name, outline in outlines:
            if field is not None and polygons_overlap(outline, field):
                yield Fault("stones", f"overlap region {name!r}")


def _has_interior(outline: tuple[Pair, ...], edge: float) -> bool:
    """Return whether a polygon has interior points farther than `edge` from its sides."""
    x, y = (sum(c[k] for c in outline) / len(outline) for k in range(2))
    return all(
        ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / math.hypot(bx - ax, by - ay) > edge
        for (ax, ay), (bx, by) in zip(outline, outline[1:] + outline[:1], strict=True)
    )


def fit_slope(corners: tuple[Vector, ...]) -> Pair:
    """Return the rise along x and y of the plane of a polygon's largest triangle."""
    x, y, z = corners[0]
    best, rise = 0.0, (0.0, 0.0)
    for previous, following in pairwise(corners[1:]):
        a, b = (
            (previous[0] - x, previous[1] - y, previous[2] - z),
            (following[0] - x, following[1] - y, following[2] - z),
        )
        area = a[0] * b[1] - a[1] * b[0]
        if abs(area) > best:
            best = abs(area)
            rise = ((a[2] * b[1] - b[2] * a[1]) / area, (a[0] * b[2] - b[0] * a[2]) / area)
    return rise


def polygons_overlap(polygon: tuple[Pair, ...], second_polygon: tuple[Pair, ...]) -> bool:
    """Return whether two convex polygons overlap, by the separating-axis theorem."""
    for outline in (polygon, second_polygon):
        for (x0, y0), (x1, y1) in zip(outline, outline[1:] + outline[:1], strict=True):
            length = math.hypot(x1 - x0, y1 - y0)
            a, b = (y1 - y0) / length, (x0 - x1) / length
            first, second = (
                [a * x + b * y for x, y in points] for points in (polygon, second_polygon)
            )
            if max(first) <= min(second) + 1e-9 or max(second) <= min(first) + 1e-9:
                return False
    return True


def _list_rectangle(x: Interval, y: Interval) -> tuple[Pair, ...]:
    """Return the corners of a rectangle along x and y."""
    (x0, x1), (y0, y1) = x, y
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def _cross_product(before: Vector, vertex: Vector, after: Vector) -> float:
    """Return the cross product of two consecutive sides."""
    incoming = (vertex[0] - before[0], vertex[1] - before[1])
    outgoing = (after[0] - vertex[0], after[1] - vertex[1])
    return incoming[0] * outgoing[1] - incoming[1] * outgoing[0]
