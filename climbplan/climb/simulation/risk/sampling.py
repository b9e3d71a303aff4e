"""Evaluate a plan in sampled worlds, if a spec or robot file states what is uncertain.

The quasi-static engine simulates NUM_WORLDS worlds, whatever time that takes: the same plan and
seed give the same counts. The plan is not changed; `risk` of a spec requests that (`planning.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import WorldSample, compute_wilson_interval
from climbplan.climb.simulation.risk.estimation import RiskEstimate, count_causes, estimate_risk
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import Engine

ENGINE: Engine = "statics"
NUM_WORLDS = 200
_NUM_CAUSES = 3


def sample_worlds(
    plan: ClimbPlan,
    seed: int,
    worlds: int = NUM_WORLDS,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> WorldSample:
    """Simulate a plan in worlds 0 to `worlds` - 1 of a seed and count falls.

    Args:
        plan: The plan, whose spec and robot file say what is uncertain.
        seed: Seed of the worlds.
        worlds: Number of worlds.
        workers: Processes; counts do not depend on them.
        progress: Called with the fraction of worlds that is done.

    Raises:
        UsageError: The quasi-static engine has no model of the robot.
    """
    risk = estimate_risk(
        plan, Conditions(), ENGINE, worlds, seed, workers=workers, progress=progress
    )
    return summarise_worlds(risk, plan)


def summarise_worlds(risk: RiskEstimate, plan: ClimbPlan) -> WorldSample:
    """Summarise an estimate: falls with their confidence interval and most frequent causes."""
    count = len(risk.outcomes)
    lower, upper = compute_wilson_interval(count - risk.falls, count)
    uncertainty = risk.layout.uncertainty
    spreads = {f.name: getattr(uncertainty, f.name) for f in fields(uncertainty)}
    return WorldSample(
        engine=risk.engine,
        seed=risk.seed,
        worlds=count,
        falls=risk.falls,
        lower=lower,
        upper=upper,
        uncertainty={k: [s.kind, s.low, s.high] for k, s in spreads.items() if not s.exact},
        causes=tuple(
            f"{frequency}: {cause}{f', {limb}' if limb else ''}, round {number}"
            for (cause, limb, number), frequency in count_causes(risk, plan.robot.limb_names, plan)
        )[:_NUM_CAUSES],
    )


def add_world_sample(
    plan: ClimbPlan,
    seed: int,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> ClimbPlan:
    """Return the plan with its sample of worlds, or with a warning if the engine has no model."""
    try:
        sample = sample_worlds(plan, seed, workers=workers, progress=progress)
    except UsageError as error:
        warning = f"the worlds of `uncertainty` are not judged: {error}"
        return replace(plan, warnings=(*plan.warnings, warning))
    verdict = "enough" if sample.enough else "TOO FEW"
    line = f"{'worlds':<9} {verdict:<9} {sample.stands} ({sample.engine}), {sample.interval}"
    return replace(plan, sample=sample, summary=(*plan.summary, line))
