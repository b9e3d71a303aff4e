"""Plans judged in a sample of worlds, where a spec or robot file states what is uncertain.

The quasi-static engine plays WORLDS worlds, whatever time that takes: the same plan and seed give
the same counts. Nothing is planned again; `risk:` of a spec asks for that (`planning.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import WorldSample, wilson_interval
from climbplan.climb.simulation.risk.judging import Judged, causes, judge_plan
from climbplan.errors import UsageError
from climbplan.simulation.asked import Engine
from climbplan.simulation.conditions import Conditions

ENGINE: Engine = "statics"
WORLDS = 200
_NUM_CAUSES = 3


def sample_worlds(
    plan: ClimbPlan,
    seed: int,
    worlds: int = WORLDS,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> WorldSample:
    """Play a plan in worlds 0 to `worlds` - 1 of a seed and count falls.

    Args:
        plan: The plan, whose spec and robot file say what is uncertain.
        seed: Seed of the worlds.
        worlds: How many are played.
        workers: Processes; counts do not depend on them.
        progress: Called with the fraction of worlds that is done.

    Raises:
        UsageError: The quasi-static engine has no model of the robot.
    """
    judged = judge_plan(plan, Conditions(), ENGINE, worlds, seed, workers, progress)
    return sample_of(judged, plan)


def sample_of(judged: Judged, plan: ClimbPlan) -> WorldSample:
    """The counts of worlds that were played, with what began the falls."""
    count = len(judged.outcomes)
    lower, upper = wilson_interval(count - judged.falls, count)
    uncertainty = judged.layout.uncertainty
    spreads = {f.name: getattr(uncertainty, f.name) for f in fields(uncertainty)}
    return WorldSample(
        engine=judged.engine,
        seed=judged.seed,
        worlds=count,
        falls=judged.falls,
        lower=lower,
        upper=upper,
        uncertainty={k: [s.kind, s.low, s.high] for k, s in spreads.items() if not s.exact},
        causes=tuple(
            f"{many}: {cause}{f', {limb}' if limb else ''}, round {number}"
            for (cause, limb, number), many in causes(judged, plan.robot.limb_names, plan)
        )[:_NUM_CAUSES],
    )


def with_world_sample(
    plan: ClimbPlan,
    seed: int,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> ClimbPlan:
    """The plan with its sample of worlds, or with a warning where the engine has no model of it."""
    try:
        sample = sample_worlds(plan, seed, workers=workers, progress=progress)
    except UsageError as error:
        warning = f"the worlds of `uncertainty` are not judged: {error}"
        return replace(plan, warnings=(*plan.warnings, warning))
    word = "enough" if sample.enough else "TOO FEW"
    line = f"{'worlds':<9} {word:<9} {sample.stands} ({sample.engine}), {sample.interval}"
    return replace(plan, sample=sample, summary=(*plan.summary, line))
