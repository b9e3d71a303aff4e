"""Terrain spec: ground, boxes, walls, tubes, contact regions, obstacles and free space."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from climbplan.schema.base import (
    Fault,
    Interval,
    Number,
    SpecModel,
    Vector,
    name_field,
    quantity,
    refuse,
)
from climbplan.schema.terrain.panel import PanelSpec, RegionHoldSpec
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.schema.terrain.shapes import check_hull, check_polygon


def _check_interval(key: str, interval: tuple[float, float]) -> list[Fault]:
    low, high = interval
    if low < high:
        return []
    return [Fault(key, f"expected [from, to] with from < to, got [{low:g}, {high:g}]")]


class RectangleSpec(SpecModel):
    """A flat rectangle in space."""

    center: Vector = quantity("m", "centre of the rectangle")
    normal: Vector = quantity("", "direction into free space (need not have unit length)")
    width: Number = quantity("m", "horizontal extent", gt=0)
    height: Number = quantity("m", "extent along the slope, perpendicular to `width`", gt=0)

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if max(map(abs, self.normal)) < 1e-9:
            refuse([Fault("normal", f"expected a direction, got {list(self.normal)}")])
        return self


class RegionSpec(SpecModel):
    """A convex flat contact region: a rectangle or a convex polygon."""

    name: str = name_field("name used in reports")
    rectangle: RectangleSpec | None = Field(default=None, description="the region as a rectangle")
    vertices: tuple[Vector, ...] | None = quantity(
        "m", "corners of a convex flat polygon, anticlockwise seen from free space", default=None
    )
    friction: Number | None = quantity(
        "", "friction coefficient; `terrain.friction` if left out", default=None, gt=0
    )
    limbs: tuple[str, ...] | None = Field(
        default=None, description="limbs that may use the region; all if left out"
    )
    hold: RegionHoldSpec | None = Field(
        default=None, description="how grippers hold on there; as on a plane if left out"
    )

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if (self.rectangle is None) == (self.vertices is None):
            both = "got both" if self.rectangle else "got neither"
            refuse([Fault("", f"expected either `rectangle` or `vertices`, {both}")])
        if self.vertices is not None and (fault := check_polygon(self.vertices)):
            refuse([Fault("vertices", fault)])
        return self


class WallsSpec(SpecModel):
    """Two plane upright walls, left at negative x and right at positive x.

    With an angle they open towards +y; the gap is kept at y = 0.
    """

    gap: Number = quantity("m", "distance between the walls at y = 0", gt=0)
    angle_deg: Number = quantity(
        "deg", "horizontal angle between the walls", default=0.0, gt=-170, lt=170
    )
    along: Interval = quantity("m", "extent of both walls along y, from and to")
    up: Interval = quantity("m", "extent of both walls along z, from and to")
    friction: Number | None = quantity(
        "", "friction coefficient; `terrain.friction` if left out", default=None, gt=0
    )

    @model_validator(mode="after")
    def _extents(self) -> Self:
        faults = [*_check_interval("along", self.along), *_check_interval("up", self.up)]
        opening = 2 * math.tan(math.radians(self.angle_deg) / 2)  # change of the gap along y
        y = min(self.along, key=lambda y: y * opening)
        if self.gap + y * opening <= 0:
            meet = -self.gap / opening
            faults.append(Fault("along", f"the walls meet at y = {meet:.3g} m, inside the extent"))
        refuse(faults)
        return self


class GroundSpec(SpecModel):
    """Level ground, a rectangle that all limbs may stand on."""

    height: Number = quantity("m", "z of the ground", default=0.0)
    across: Interval = quantity("m", "extent along x, from and to")
    along: Interval = quantity("m", "extent along y, from and to")
    friction: Number | None = quantity(
        "", "friction coefficient; `terrain.friction` if left out", default=None, gt=0
    )

    @model_validator(mode="after")
    def _extents(self) -> Self:
        refuse([*_check_interval("across", self.across), *_check_interval("along", self.along)])
        return self


class BoxSpec(SpecModel):
    """An axis-aligned solid box whose top is a contact region: a brick, a step."""

    name: str = name_field("name used in reports")
    lower: Vector = quantity("m", "lower corner")
    upper: Vector = quantity("m", "upper corner")
    friction: Number | None = quantity(
        "", "friction coefficient of its top; `terrain.friction` if left out", default=None, gt=0
    )
    limbs: tuple[str, ...] | None = Field(
        default=None, description="limbs that may stand on it; all if left out"
    )

    @model_validator(mode="after")
    def _extents(self) -> Self:
        refuse(
            [
                Fault("lower", f"the box is empty along {axis}: lower {low:g}, upper {high:g}")
                for axis, low, high in zip("xyz", self.lower, self.upper, strict=True)
                if low >= high
            ]
        )
        return self


class TubeSpec(SpecModel):
    """The inside of a round upright tube (method `nlp` only)."""

    radius: Number = quantity("m", "inner radius", gt=0)
    center: tuple[Number, Number] = quantity("m", "axis position (x, y)", default=(0.0, 0.0))
    up: Interval = quantity("m", "extent along z, from and to")

    @model_validator(mode="after")
    def _extents(self) -> Self:
        refuse(_check_interval("up", self.up))
        return self


class SolidSpec(SpecModel):
    """A convex body: an axis-aligned box or the hull of points."""

    name: str = name_field("name used in reports")
    lower: Vector | None = quantity("m", "lower corner of a box", default=None)
    upper: Vector | None = quantity("m", "upper corner of a box", default=None)
    vertices: tuple[Vector, ...] | None = quantity("m", "points whose hull it is", default=None)

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        box = self.lower is not None and self.upper is not None
        if (self.lower is None) != (self.upper is None) or box == (self.vertices is not None):
            expected = "expected either `lower` and `upper` (a box) or `vertices` (a hull)"
            refuse([Fault("", expected)])
        if self.lower is not None and self.upper is not None:
            refuse(
                [
                    Fault("lower", f"the box is empty along {axis}: lower {low:g}, upper {high:g}")
                    for axis, low, high in zip("xyz", self.lower, self.upper, strict=True)
                    if low >= high
                ]
            )
        if self.vertices is not None and (fault := check_hull(self.vertices)):
            refuse([Fault("vertices", fault)])
        return self


class TerrainSpec(SpecModel):
    """Where toes may stand and what must not be touched."""

    friction: Number = quantity("", "friction coefficient where a region has none", gt=0)
    regions: tuple[RegionSpec, ...] = Field(default=(), description="flat contact regions")
    walls: WallsSpec | None = Field(default=None, description="two walls as one region each")
    ground: GroundSpec | None = Field(default=None, description="level ground to stand on")
    panel: PanelSpec | None = Field(default=None, description="one plane with graspable holds")
    boxes: tuple[BoxSpec, ...] = Field(
        default=(), description="solid boxes whose tops limbs may stand on"
    )
    tube: TubeSpec | None = Field(default=None, description="round tube instead of flat regions")
    scan: ScanSpec | None = Field(
        default=None, description="mesh, point cloud or height map of the terrain"
    )
    obstacles: tuple[SolidSpec, ...] = Field(
        default=(), description="solids that body, limbs and swing paths must clear"
    )
    free_regions: tuple[SolidSpec, ...] = Field(
        default=(),
        description="convex free space for the body; derived from `obstacles` or found "
        "in `scan` if left out",
    )

    @property
    def gripped(self) -> bool:
        """Return whether limbs hold on by grippers, to stated holds or to those of a scan."""
        stated = self.panel is not None or any(r.hold is not None for r in self.regions)
        return stated or (self.scan is not None and self.scan.holds is not None)

    @model_validator(mode="after")
    def _some_surface(self) -> Self:
        flat = bool(self.regions or self.boxes) or self.walls is not None
        flat = flat or self.ground is not None or self.panel is not None
        flat = flat or (self.scan is not None and self.scan.fit)
        faults = []
        if self.scan is not None and self.scan.holds is not None and self.scan.fit and self.panel:
            message = "expected either holds to be found in the scan or a stated `panel`"
            faults.append(Fault("scan.holds", message))
        if self.tube is not None and flat:
            faults.append(
                Fault(
                    "tube", "expected either flat regions (`regions`, `walls`, `ground`) or `tube`"
                )
            )
        if not flat and self.tube is None:
            faults.append(Fault("", "nothing to stand on: expected `regions`, `walls` or `tube`"))
        places_by_name = {"left": "a wall", "right": "a wall"} if self.walls is not None else {}
        if self.ground is not None:
            places_by_name["ground"] = "the ground"
        if self.panel is not None:
            places_by_name["panel"] = "the panel"
        names = [
            *((name, f"panel.holds.{name}") for name in (self.panel.holds if self.panel else ())),
            *((b.name, f"boxes.{i}") for i, b in enumerate(self.boxes)),
            *((r.name, f"regions.{i}") for i, r in enumerate(self.regions)),
            *((s.name, f"obstacles.{i}") for i, s in enumerate(self.obstacles)),
            *((s.name, f"free_regions.{i}") for i, s in enumerate(self.free_regions)),
        ]
        for name, place in names:
            first = places_by_name.setdefault(name, place)
            if first != place:
                message = f"names must differ, {name!r} is also {first}"
                faults.append(Fault(f"{place}.name", message))
        refuse(faults)
        return self
