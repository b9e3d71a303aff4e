"""Terrain spec: contact regions, walls, tubes, obstacles and free space."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from climbplan.spec.base import Interval, Number, SpecModel, Vector, quantity


class RectangleSpec(SpecModel):
    """A flat rectangle in space."""

    center: Vector = quantity("m", "centre of the rectangle")
    normal: Vector = quantity("", "direction into free space (need not have unit length)")
    width: Number = quantity("m", "horizontal extent", gt=0)
    height: Number = quantity("m", "extent along the slope, perpendicular to `width`", gt=0)


class RegionSpec(SpecModel):
    """A convex flat contact region: a rectangle or a convex polygon."""

    name: str = Field(min_length=1, description="name used in reports")
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

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if (self.rectangle is None) == (self.vertices is None):
            raise ValueError("expected either `rectangle` or `vertices`")
        if self.vertices is not None and len(self.vertices) < 3:
            raise ValueError("vertices: an area needs at least three corners")
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


class TubeSpec(SpecModel):
    """The inside of a round upright tube (method `nlp` only)."""

    radius: Number = quantity("m", "inner radius", gt=0)
    center: tuple[Number, Number] = quantity("m", "axis position (x, y)", default=(0.0, 0.0))
    up: Interval = quantity("m", "extent along z, from and to")


class SolidSpec(SpecModel):
    """A convex body: an axis-aligned box or the hull of points."""

    name: str = Field(min_length=1, description="name used in reports")
    lower: Vector | None = quantity("m", "lower corner of a box", default=None)
    upper: Vector | None = quantity("m", "upper corner of a box", default=None)
    vertices: tuple[Vector, ...] | None = quantity("m", "points whose hull it is", default=None)

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        box = self.lower is not None and self.upper is not None
        if (self.lower is None) != (self.upper is None) or box == (self.vertices is not None):
            raise ValueError("expected either `lower` and `upper` (a box) or `vertices` (a hull)")
        if self.lower is not None and self.upper is not None:
            for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
                if low >= high:
                    raise ValueError(f"box is empty along {axis}: lower {low} >= upper {high}")
        if self.vertices is not None and len(self.vertices) < 4:
            raise ValueError("vertices: a solid needs at least four points")
        return self


class TerrainSpec(SpecModel):
    """Where toes may stand and what must not be touched."""

    friction: Number = quantity("", "friction coefficient where a region has none", gt=0)
    regions: tuple[RegionSpec, ...] = Field(default=(), description="flat contact regions")
    walls: WallsSpec | None = Field(default=None, description="two walls as one region each")
    tube: TubeSpec | None = Field(default=None, description="round tube instead of flat regions")
    obstacles: tuple[SolidSpec, ...] = Field(
        default=(), description="solids that body, limbs and swing paths must clear"
    )
    free_regions: tuple[SolidSpec, ...] = Field(
        default=(),
        description="convex free space for the body; derived from `obstacles` if left out",
    )

    @model_validator(mode="after")
    def _some_surface(self) -> Self:
        flat = bool(self.regions) or self.walls is not None
        if self.tube is not None and flat:
            raise ValueError("expected either flat regions (`regions`, `walls`) or `tube`")
        if not flat and self.tube is None:
            raise ValueError("no surface to stand on: expected `regions`, `walls` or `tube`")
        names = [r.name for r in self.regions]
        names += [s.name for s in (*self.obstacles, *self.free_regions)]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names must differ, {', '.join(twice)} appears twice")
        for pair, label in (
            (self.walls and self.walls.along, "walls.along"),
            (self.walls and self.walls.up, "walls.up"),
            (self.tube and self.tube.up, "tube.up"),
        ):
            if pair and pair[0] >= pair[1]:
                raise ValueError(f"{label}: expected [from, to] with from < to, got {list(pair)}")
        return self
