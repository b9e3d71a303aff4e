"""Plan a spec at several values of a key and simulate each plan in the same random worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_text
from climbplan.climb.schema.transition_loading import load_transition_text
from climbplan.climb.simulation.variations import draw_conditions, run_climb_trial
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import NoPlanFound, ReachFailure
from climbplan.schema.source import SourceText
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.trials import FallRate, RandomRun, run_trials


@dataclass(frozen=True)
class SweepPoint:
    """The trials at one value of a spec's key."""

    value: float
    trials: tuple[RandomRun, ...]
    no_plan: str  # why there is no plan at this value, "" if there is one

    @property
    def fall_share(self) -> FallRate:
        """Falls among the trials."""
        return FallRate(sum(t.fallen for t in self.trials), len(self.trials))


@dataclass(frozen=True)
class SweepSettings:
    """Settings of a sweep."""

    key: str  # of the spec
    values: tuple[float, ...]
    base: Conditions
    runs: int  # at each value
    seed: int
    jobs: int = 1
    most_backlash: float = 0.0  # [rad]


def sweep(
    plan: ClimbPlan, settings: SweepSettings, progress: Callable[[float], None] | None = None
) -> tuple[SweepPoint, ...]:
    """Plan the spec of a plan at each value of a key and simulate it in the same random worlds.

    Args:
        plan: The plan whose spec is used.
        settings: Key, values and worlds.
        progress: Called with the fraction that is done.

    Raises:
        SpecError: The spec does not take the key or value.
    """
    points = []
    for index, value in enumerate(settings.values):
        try:
            variant = _plan_override(plan, f"{settings.key}={value!r}")
        except (NoPlanFound, ReachFailure) as error:
            points.append(SweepPoint(value, (), str(error).splitlines()[0]))
            continue
        worlds = draw_conditions(
            variant, settings.base, settings.runs, settings.seed, settings.most_backlash
        )

        def report_fraction(fraction: float, done: int = index) -> None:
            if progress is not None:
                progress((done + fraction) / len(settings.values))

        trials = run_trials(
            partial(run_climb_trial, variant), worlds, settings.jobs, report_fraction
        )
        points.append(SweepPoint(value, trials, ""))
    return tuple(points)


def _plan_override(plan: ClimbPlan, override: str) -> ClimbPlan:
    """Plan the spec of a plan with an override."""
    if plan.kind == "transition":
        text = SourceText(plan.name, plan.name, Path.cwd(), plan.spec_text)
        return plan_transition(load_transition_text(text, [override]))
    return plan_climb(load_text(plan.spec_text, plan.name, [override]))
