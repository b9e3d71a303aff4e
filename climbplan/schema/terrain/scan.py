"""Terrain from a file: a triangle mesh, a point cloud or a height map."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, Vector, quantity, refuse


class TransformSpec(SpecModel):
    """Where the scan stands in the world: turned about its origin first, then moved."""

    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw of the scan", default=(0.0, 0.0, 0.0))
    move: Vector = quantity("m", "its origin in the world", default=(0.0, 0.0, 0.0))


class CropSpec(SpecModel):
    """The part of the scan that counts, an axis-aligned box of the world."""

    lower: Vector = quantity("m", "lower corner")
    upper: Vector = quantity("m", "upper corner")

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


class ScanHoldsSpec(SpecModel):
    """What grippers can hold on a scanned wall: places where both fingers touch a side."""

    opening: Number | None = quantity(
        "m",
        "between the open fingers; the `finger_span` of the robot's gripper if left out",
        default=None,
        gt=0,
        le=0.5,
    )
    depth: Number = quantity(
        "m", "that fingers reach down beside what they grip", default=0.015, gt=0, le=0.2
    )
    steepest_back_deg: Number = quantity(
        "deg", "that a gripped side may lean back at most", default=45.0, ge=0, lt=90
    )


class ScanSpec(SpecModel):
    """A scanned surface, in which contact regions and free space are found."""

    file: str = Field(
        min_length=1,
        description="mesh (STL, OBJ, PLY, GLB, DAE), point cloud (PCD, PLY, XYZ, NPY, LAS) or "
        "height map (TIFF, PNG, NPY, CSV); a relative path starts from the spec's folder",
    )
    scale: Number = quantity("m", "length of one unit of the file", default=1.0, gt=0)
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = Field(
        default="z", description="axis of the file that points up"
    )
    transform: TransformSpec = TransformSpec()
    """Where the scan stands in the world, after `scale` and `up`."""
    crop: CropSpec | None = Field(default=None, description="the part that counts; all if left out")
    cell: Number | None = quantity(
        "m", "of height maps: width of a cell; that of the GeoTIFF if left out", default=None, gt=0
    )
    origin: Vector | None = quantity(
        "m", "of height maps: first row and column, height zero", default=None
    )
    height: Number = quantity("m", "of height maps: height of one count", default=1.0, gt=0)
    flatness: Number = quantity(
        "m", "largest distance of a region from the raw surface", default=0.005, gt=0, le=0.1
    )
    min_size: Number = quantity(
        "m", "smallest width of a region; smaller ones are left out", default=0.02, ge=0
    )
    toe_radius: Number = quantity(
        "m", "room that toes keep from edges and from what rises beside them", default=0.01, ge=0
    )
    steepest_deg: Number = quantity(
        "deg",
        "steepest region that counts, from level ground (0) over walls (90) to ceilings (180)",
        default=180.0,
        ge=0,
        le=180,
    )
    friction: dict[str, Number] = quantity(
        "",
        "friction coefficients by material name or colour (`#rrggbb`) of the file; "
        "`terrain.friction` for all others",
        default={},
    )
    guide: tuple[Vector, ...] = quantity(
        "m",
        "points that the body passes between start and goal; the straight way if left out",
        default=(),
    )
    holds: ScanHoldsSpec | None = Field(
        default=None,
        description="look for holds of grippers on a scanned wall (`holds: {}`), instead of "
        "contact regions: they become `terrain.panel`",
    )
    fit: bool = Field(
        default=True,
        description="whether contact regions and free space are found in it; if not, those that "
        "the spec lists are used, and the scan is what they are checked against",
    )

    @model_validator(mode="after")
    def _positive(self) -> Self:
        refuse(
            [
                Fault(f"friction.{name}", f"expected a coefficient above zero, got {value:g}")
                for name, value in self.friction.items()
                if value <= 0
            ]
        )
        return self
