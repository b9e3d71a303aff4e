"""Panel spec: one plane with graspable holds, as level ground, wall, overhang or ceiling."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, Vector, quantity, refuse

FLAT_DEG = -90.0  # undercut of a plane surface: both fingers on the plane itself


class HoldSpec(SpecModel):
    """A hold: where it is on the panel, and how its two gripped sides are inclined."""

    at: tuple[Number, Number] = quantity("m", "its middle, across the panel and up along it")
    width: Number = quantity("m", "room for the grip's centre across", default=0.03, gt=0)
    height: Number = quantity("m", "room for the grip's centre along the panel", default=0.03, gt=0)
    axis_deg: Number = quantity(
        "deg",
        "direction in which the fingers close, from `up the panel` towards `across`: 0 above and "
        "below the hold, 90 on its left and right",
        default=0.0,
    )
    undercut_deg: Number = quantity(
        "deg",
        "inclination of the gripped sides: 0 at right angles to the panel, above 0 undercut so "
        "that gripping pulls towards the panel, -90 no hold but the plane itself",
        default=0.0,
        ge=FLAT_DEG,
        lt=90,
    )
    orientation_deg: Vector = quantity(
        "deg",
        "turn of the hold's surface against the gripper about its x, y and z axes: with the "
        "friction coefficient, what the spines' shear force depends on",
        default=(0.0, 0.0, 0.0),
    )
    friction: Number | None = quantity(
        "", "friction coefficient; that of the panel if left out", default=None, gt=0
    )
    limbs: tuple[str, ...] | None = Field(
        default=None, description="limbs that may use the hold; all if left out"
    )


class RegionHoldSpec(SpecModel):
    """How grippers hold on where a region is: two sides that fingers press on."""

    axis: Vector = quantity(
        "", "direction in which the fingers close (its part along the region counts)"
    )
    undercut_deg: Number = quantity(
        "deg",
        "inclination of the gripped sides: 0 at right angles to the region, above 0 undercut",
        default=0.0,
        ge=FLAT_DEG,
        lt=90,
    )
    orientation_deg: Vector = quantity(
        "deg",
        "turn of the hold's surface against the gripper, as of a panel's holds",
        default=(0.0, 0.0, 0.0),
    )

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if max(map(abs, self.axis)) < 1e-9:
            refuse([Fault("axis", f"expected a direction, got {list(self.axis)}")])
        return self


class PanelSpec(SpecModel):
    """A rectangle with holds, on which limbs stand on the holds alone."""

    angle_deg: Number = quantity(
        "deg",
        "90: an upright wall that faces -y; above: it overhangs; 180: a ceiling; 0: the ground",
        default=90.0,
        ge=0,
        le=180,
    )
    heading_deg: Number = quantity(
        "deg", "turn about z: an upright wall faces -y at 0, +x at 90", default=0.0
    )
    center: Vector = quantity("m", "origin of the holds' coordinates", default=(0.0, 0.0, 0.0))
    across: tuple[Number, Number] = quantity("m", "extent across, from and to")
    along: tuple[Number, Number] = quantity("m", "extent up along the panel, from and to")
    friction: Number | None = quantity(
        "", "friction coefficient; `terrain.friction` if left out", default=None, gt=0
    )
    holds: dict[str, HoldSpec] = Field(min_length=1, description="holds by name")

    @model_validator(mode="after")
    def _extents(self) -> Self:
        faults = [
            Fault(key, f"expected [from, to] with from < to, got [{low:g}, {high:g}]")
            for key, (low, high) in (("across", self.across), ("along", self.along))
            if low >= high
        ]
        faults += [
            Fault(f"holds.{name}.at", f"expected a place on the panel, got {list(hold.at)}")
            for name, hold in self.holds.items()
            if not (
                self.across[0] <= hold.at[0] <= self.across[1]
                and self.along[0] <= hold.at[1] <= self.along[1]
            )
        ]
        refuse(faults)
        return self
