"""Feet of finite size: what touches the terrain at the ends of a robot's legs."""

from __future__ import annotations

from climbplan.spec.base import Number, SpecModel, quantity


class FootSpec(SpecModel):
    """Feet of finite size, the same at the end of every leg; points if left out."""

    radius: Number = quantity(
        "m",
        "radius of spherical feet: a toe is then the sphere's centre, which stays so far off the "
        "surfaces that the foot touches",
        gt=0,
    )
