"""Five-bar legs: what is the same in every leg of a robot that has them."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from climbplan.schema.base import Fault, Number, SpecModel, quantity, refuse


class FiveBarSpec(SpecModel):
    """Two cranks in the leg's vertical plane, the last link on one of them, a coupler to the other.

    Joints are yaw, crank F and crank A; crank angles count from straight down towards outward. A
    limb's `link_lengths` are not used by such legs but to draw them.
    """

    offset: Number = quantity("m", "of both cranks' axes, outward from the yaw axis", default=0.0)
    axis_f: Number = quantity("m", "height of crank F's axis above the shoulder")
    axis_a: Number = quantity("m", "height of crank A's axis above the shoulder")
    crank_f: Number = quantity("m", "length of crank F, which carries the last link", gt=0)
    crank_a: Number = quantity("m", "length of crank A", gt=0)
    coupler: Number = quantity("m", "length of the coupler between crank A and the link", gt=0)
    link: Number = quantity("m", "from crank F's end to the toe", gt=0)
    held_along: Number = quantity("m", "where the coupler holds the link: along it", gt=0)
    held_across: Number = quantity("m", "and beside it, towards growing tilt", default=0.0)

    @model_validator(mode="after")
    def _closes(self) -> Self:
        held = (self.held_along**2 + self.held_across**2) ** 0.5
        longest = self.crank_f + self.crank_a + held + abs(self.axis_f - self.axis_a)
        if self.coupler >= longest:
            refuse([Fault("coupler", f"expected less than {longest:.3g}, or nothing ever closes")])
        return self
