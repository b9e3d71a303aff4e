"""What climbs and transitions ask of the force planner (chapter 5.1.4).

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from climbplan.schema.base import Count, Number, SpecModel, quantity


class ForcePlannerSpec(SpecModel):
    """The force planner (second stage)."""

    safety_friction: Number = quantity("", "S_mu, friction safety factor", default=1.8, ge=1)
    safety_torque: Number = quantity("", "least S_tau, torque safety factor", default=1.0, ge=1)
    normal_force_weight: Number = quantity(
        "1/N", "w: how much pressing harder is worth against torque", default=2e-4, ge=0
    )
    min_normal_force: Number = quantity(
        "N",
        "pressure of every toe in contact at least: a toe that presses with next to nothing slides "
        "at the first disturbance (`climbplan simulate`)",
        default=0.0,
        ge=0,
    )
    min_penetration: Number | None = Field(
        default=None,
        ge=0,
        description="how far inside its surface [m] every toe in contact is commanded at least; "
        "left out, friction alone may hold a toe that is commanded off its surface, which slides "
        "or never touches at the first disturbance (`climbplan simulate`)",
    )
    facets: Count = quantity(
        "", "sides of the pyramid inscribed in the friction cone", default=16, ge=4, le=128
    )
    deflection_compensation: Literal["predicted", "compensated"] = Field(
        default="compensated",
        description="`compensated`: joint commands hold the body at its planned pose; `predicted`: "
        "least commanded penetration, the body moves about as reported (a linear estimate)",
    )
    min_stiffness_ratio: Number = quantity(
        "",
        "share of the body's stiffness that the forces leave at least; at 0 a robot that braces "
        "itself buckles",
        default=0.02,
        ge=0,
        lt=1,
    )
