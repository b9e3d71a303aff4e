"""Plans made anew at several values of a key, each simulated in the same random worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_text
from climbplan.climb.schema.transition_loading import transition_of_text
from climbplan.climb.simulation.variations import climb_trial, drawn_conditions
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import NoPlanFound, ReachFailure
from climbplan.schema.source import SourceText
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.trials import Share, Trial, run_trials


@dataclass(frozen=True)
class SweepPoint:
    """What happened at one value of a spec's key."""

    value: float
    trials: tuple[Trial, ...]
    no_plan: str  # why there is no plan at this value, "" if there is one

    @property
    def share(self) -> Share:
        """Falls among the trials."""
        return Share(sum(t.fallen for t in self.trials), len(self.trials))


@dataclass(frozen=True)
class Sweep:
    """What is asked of a sweep."""

    key: str  # of the spec
    values: tuple[float, ...]
    base: Conditions
    runs: int  # at each value
    seed: int
    jobs: int = 1
    most_backlash: float = 0.0  # [rad]


def sweep(
    plan: ClimbPlan, asked: Sweep, progress: Callable[[float], None] | None = None
) -> tuple[SweepPoint, ...]:
    """Plan the same spec anew at each value of a key and simulate it in the same random worlds.

    Raises SpecError for a key or value that the spec does not take.
    """
    points = []
    for index, value in enumerate(asked.values):
        try:
            other = _planned(plan, f"{asked.key}={value!r}")
        except (NoPlanFound, ReachFailure) as error:
            points.append(SweepPoint(value, (), str(error).splitlines()[0]))
            continue
        worlds = drawn_conditions(other, asked.base, asked.runs, asked.seed, asked.most_backlash)

        def part(share: float, done: int = index) -> None:
            if progress is not None:
                progress((done + share) / len(asked.values))

        trials = run_trials(partial(climb_trial, other), worlds, asked.jobs, part)
        points.append(SweepPoint(value, trials, ""))
    return tuple(points)


def _planned(plan: ClimbPlan, override: str) -> ClimbPlan:
    """The plan's own spec with one value changed, planned."""
    if plan.kind == "transition":
        text = SourceText(plan.name, plan.name, Path.cwd(), plan.spec_text)
        return plan_transition(transition_of_text(text, [override]))
    return plan_climb(load_text(plan.spec_text, plan.name, [override]))
