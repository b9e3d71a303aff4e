"""Datasets of random terrains (chapter 5.2.2): whether a robot can stand on them, and how.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from climbplan.climb.schema.envelopes import EnvelopeTerrainSpec
from climbplan.schema.base import Count, Number, SpecModel, quantity


class TerrainSolverSpec(SpecModel):
    """Branch and bound over parts of the patches."""

    method: Literal["exact"] = Field(
        default="exact", description="`exact`: a posture, or the proof that there is none"
    )
    node_limit: Count = quantity(
        "", "of the search, after which a terrain stays undecided", default=300, ge=1
    )
    time_limit: Number = quantity(
        "s",
        "of a row, its draws included; a worker beyond ten times it is ended",
        default=60.0,
        gt=0,
    )


class TerrainsProblemSpec(SpecModel):
    """Random terrains, one patch for each limb: whether the robot can stand on them, and how."""

    kind: Literal["terrains"] = Field(description="always `terrains`")
    robot: str = Field(
        min_length=1, description="built-in robot (`silvia`) or path of a robot YAML"
    )
    terrain: EnvelopeTerrainSpec
    """What terrains are drawn from."""
    feasible_fraction: Number = quantity(
        "",
        "fraction of rows for which a feasible terrain is drawn; the others get an infeasible one "
        "on which forces alone would balance",
        default=0.5,
        ge=0,
        le=1,
    )
    max_attempts: Count = quantity(
        "", "terrains drawn for one row before it is given up", default=5000, ge=1, le=1_000_000
    )
    solver: TerrainSolverSpec = TerrainSolverSpec()
    """Limits."""
