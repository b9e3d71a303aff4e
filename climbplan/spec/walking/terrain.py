"""Ground that a quadruped walks on: flat without end, or level regions."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from climbplan.spec.base import Fault, Interval, Number, SpecModel, quantity, refuse


class LevelRegionSpec(SpecModel):
    """A level rectangle that toes may stand on."""

    name: str = Field(min_length=1, description="name used in reports")
    x: Interval = quantity("m", "extent along x, from and to")
    y: Interval = quantity("m", "extent along y, from and to")
    height: Number = quantity("m", "height of the surface", default=0.0)

    @model_validator(mode="after")
    def _extents(self) -> Self:
        refuse(
            [
                Fault(key, f"expected [from, to] with from < to, got {list(interval)}")
                for key, interval in (("x", self.x), ("y", self.y))
                if interval[0] >= interval[1]
            ]
        )
        return self


class WalkTerrainSpec(SpecModel):
    """The ground: flat without end, or level regions."""

    friction: Number = quantity("", "friction coefficient", default=1.0, gt=0, le=5)
    regions: tuple[LevelRegionSpec, ...] = Field(
        default=(), description="level regions, such as steps; flat ground if left out"
    )

    @model_validator(mode="after")
    def _apart(self) -> Self:
        faults = []
        for i, region in enumerate(self.regions):
            for other in self.regions[:i]:
                if region.name == other.name:
                    message = f"names must differ, {region.name!r} is there already"
                    faults.append(Fault(f"regions.{i}.name", message))
                if _overlap(region.x, other.x) and _overlap(region.y, other.y):
                    faults.append(Fault(f"regions.{i}", f"overlaps region {other.name!r}"))
        refuse(faults)
        return self


def _overlap(one: Interval, other: Interval) -> bool:
    return one[0] < other[1] - 1e-9 and other[0] < one[1] - 1e-9
