"""Feet of finite size: what touches the terrain at the ends of a robot's legs."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from climbplan.schema.base import Fault, Number, SpecModel, quantity, refuse


class FootSpec(SpecModel):
    """Feet of finite size, the same at the end of every leg: spheres, or flat; points if left out.

    A flat foot's sole lies square to an axis of its toe's link, that which points up in the legs'
    posture, its length along the axis that points forward there.
    """

    radius: Number | None = quantity(
        "m",
        "radius of spherical feet: a toe is then the sphere's centre, which stays so far off the "
        "surfaces that the foot touches",
        default=None,
        gt=0,
    )
    length: Number | None = quantity(
        "m",
        "length of flat feet, with `width`: a toe is then the middle of its sole, which lies flat "
        "on its surface; legs have six joints or more",
        default=None,
        gt=0,
    )
    width: Number | None = quantity("m", "width of flat feet, with `length`", default=None, gt=0)
    center: tuple[Number, Number] = quantity(
        "m",
        "middle of a flat foot's sole from the point that its leg's toe says: forward, right",
        default=(0.0, 0.0),
    )

    @property
    def flat(self) -> bool:
        """Return whether the feet have soles."""
        return self.length is not None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        faults = []
        if self.radius is not None:
            faults += [
                Fault(key, "expected spheres of `radius`, or flat feet of `length` and `width`")
                for key in ("length", "width", "center")
                if key in self.model_fields_set
            ]
        elif self.length is None and self.width is None:
            faults.append(Fault("radius", "expected it, or `length` and `width`"))
        elif self.width is None:
            faults.append(Fault("length", "expected `width` beside it"))
        elif self.length is None:
            faults.append(Fault("width", "expected `length` beside it"))
        refuse(faults)
        return self
