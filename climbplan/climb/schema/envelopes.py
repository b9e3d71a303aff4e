"""Envelopes spec (`kind: envelopes`): which terrains to learn on, and how (chapter 5.2).

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse

MIN_LIMBS = 3  # with toes that only press


class EnvelopeTerrainSpec(SpecModel):
    """Random terrains: one square patch for each limb that stands."""

    distribution: Literal["ground3", "wall3", "wall5", "ground", "wall"] = Field(
        description="`ground3`: RF, RR, LM on the ground; `wall3`: the same between walls; "
        "`wall5`: all limbs but RM between walls. Of any robot, in its own stance: `ground`: limbs "
        "on patches that look up; `wall`: on patches that look towards the middle plane of the body"
    )
    limbs: tuple[str, ...] | None = Field(
        default=None, description="that stand, of `ground` and `wall`; all if left out"
    )
    stance: dict[str, Vector] = quantity(
        "m",
        "toe positions by limb, body frame, where they differ from the robot's (`ground`, `wall`)",
        default={},
    )
    tilt_deg: Number = quantity(
        "deg", "largest angle of a patch from its nominal normal", default=30.0, ge=0, lt=90
    )
    jitter: Number = quantity(
        "m", "largest shift of a patch along each axis", default=0.1, ge=0, le=1
    )
    half_size: Number = quantity("m", "half a patch's side", default=0.05, gt=0, le=1)

    @model_validator(mode="after")
    def _own_limbs(self) -> Self:
        faults = []
        if self.distribution not in ("ground", "wall"):
            message = f"`{self.distribution}` names its limbs; expected `ground` or `wall` for that"
            stated_keys = (("limbs", self.limbs is not None), ("stance", bool(self.stance)))
            faults += [Fault(name, message) for name, is_stated in stated_keys if is_stated]
        elif self.limbs is not None and len(set(self.limbs)) != len(self.limbs):
            faults.append(Fault("limbs", "expected each limb once"))
        elif self.limbs is not None and len(self.limbs) < MIN_LIMBS:
            message = f"expected at least {MIN_LIMBS} limbs, got {len(self.limbs)}"
            faults.append(Fault("limbs", message))
        refuse(faults)
        return self

    @property
    def named_limbs(self) -> list[tuple[tuple[str | int, ...], str]]:
        """Limbs that it names, each with its key."""
        limbs = enumerate(self.limbs or ())
        named: list[tuple[tuple[str | int, ...], str]] = [(("limbs", i), n) for i, n in limbs]
        return named + [(("stance", name), name) for name in self.stance]


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
