"""Envelopes spec (`kind: envelopes`): which terrains to learn on, and how (chapter 5.2)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from climbplan.spec.base import Count, Number, SpecModel, quantity


class EnvelopeTerrainSpec(SpecModel):
    """Random terrains: one square patch for each limb that stands."""

    distribution: Literal["ground3", "wall3", "wall5"] = Field(
        description="`ground3`: RF, RR, LM on the ground; `wall3`: the same between walls; "
        "`wall5`: all limbs but RM between walls"
    )
    tilt_deg: Number = quantity(
        "deg", "largest angle of a patch from its nominal normal", default=30.0, ge=0, lt=90
    )
    jitter: Number = quantity(
        "m", "largest shift of a patch along each axis", default=0.1, ge=0, le=1
    )
    half_size: Number = quantity("m", "half a patch's side", default=0.05, gt=0, le=1)


class EnvelopeDataSpec(SpecModel):
    """How many labelled terrains to draw, or where they are; validation is held out."""

    dataset: str | None = Field(
        default=None,
        description="dataset of `gen-data` to take them from, instead of drawing: rows of its "
        "masks `train` and `test`, as `climbplan data split` writes them; relative to the spec",
    )

    training_feasible: Count = quantity("", "feasible terrains to fit to", default=500, ge=10)
    training_infeasible: Count = quantity("", "infeasible terrains to fit to", default=500, ge=1)
    validation_feasible: Count = quantity("", "held-out feasible terrains", default=500, ge=1)
    validation_infeasible: Count = quantity("", "held-out infeasible terrains", default=500, ge=1)


class GeneticSpec(SpecModel):
    """The genetic search."""

    population: Count = quantity("", "envelopes in each generation", default=30, ge=6)
    generations: Count = quantity("", "generations", default=30, ge=1)
    terrains: Count = quantity("", "terrains that each is tested on (K)", default=40, ge=2)
    delta: Number = quantity(
        "", "largest share of feasible terrains called infeasible", default=0.03, ge=0, lt=1
    )


class EnvelopeFitSpec(SpecModel):
    """How envelopes are fitted."""

    method: Literal["all", "clustering", "genetic", "heuristic"] = Field(
        default="all", description="one method, or all of them side by side"
    )
    first_stage: Literal["published", "tightened", "propagated"] = Field(
        default="propagated",
        description="`tightened`: toe bounds of the terrain also cut the envelope's box; "
        "`propagated`: and so do the bounds that all rows imply within it",
    )
    envelopes: Count = quantity(
        "", "envelopes of which a posture is in one (a binary each)", default=1, ge=1, le=4
    )
    likelihood: Number = quantity(
        "", "quantile of the points' likelihood left out (p_th)", default=0.0, ge=0, lt=1
    )
    least_feasible: Number = quantity(
        "",
        "share of training terrains that clustering's envelope is to call feasible; its box grows "
        "until it does",
        default=0.99,
        gt=0,
        le=1,
    )
    genetic: GeneticSpec = GeneticSpec()
    """The genetic search."""


class EnvelopesSpec(SpecModel):
    """Learn McCormick envelopes from labelled terrains."""

    kind: Literal["envelopes"] = Field(description="always `envelopes`")
    title: str = Field(default="", description="one line for reports")
    robot: str = Field(
        min_length=1, description="built-in robot (`silvia`) or path of a robot YAML"
    )
    terrain: EnvelopeTerrainSpec
    """What terrains are drawn from."""
    data: EnvelopeDataSpec = EnvelopeDataSpec()
    """How many of them."""
    fit: EnvelopeFitSpec = EnvelopeFitSpec()
    """How envelopes are fitted."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)
