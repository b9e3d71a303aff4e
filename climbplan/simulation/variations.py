"""Worlds drawn at random about the nominal one, and the share of plans that fall in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.planner import plan_climb
from climbplan.errors import NoPlanFound, ReachFailure
from climbplan.plans.climb_plan import ClimbPlan
from climbplan.simulation.comparison import find_slips
from climbplan.simulation.conditions import Conditions, ContactLoss
from climbplan.simulation.replay import simulate
from climbplan.spec.loading import load_text

FRICTION = (0.5, 1.05)  # factor on the terrain's coefficients
PAYLOAD = (0.0, 0.02)  # of the robot's mass
GAIN = (0.95, 1.05)  # factor on joint stiffness
LOSS = 0.2  # [s] for which one toe has no friction, at a time and limb drawn
_Z = 1.96


@dataclass(frozen=True)
class Trial:
    """One random run."""

    conditions: Conditions
    fallen: bool
    time: float  # [s] at its end, of the plan
    slips: int


@dataclass(frozen=True)
class Share:
    """Falls among runs, with a 95 % interval (Wilson)."""

    fallen: int
    runs: int

    @property
    def value(self) -> float:
        """Share of runs that fell."""
        return self.fallen / self.runs if self.runs else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share."""
        if not self.runs:
            return 0.0, 1.0
        n, p = self.runs, self.value
        middle = (p + _Z**2 / (2 * n)) / (1 + _Z**2 / n)
        half = _Z * np.sqrt(p * (1 - p) / n + _Z**2 / (4 * n**2)) / (1 + _Z**2 / n)
        return float(max(0.0, middle - half)), float(min(1.0, middle + half))


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


def drawn_conditions(
    plan: ClimbPlan, base: Conditions, count: int, seed: int
) -> tuple[Conditions, ...]:
    """Worlds about a base one; the same for every plan of the same robot, but for the duration."""
    out = []
    for child in np.random.SeedSequence(seed).spawn(count):
        rng = np.random.default_rng(child)
        limb, when = int(rng.integers(plan.robot.limb_count)), float(rng.uniform(0.05, 0.95))
        out.append(
            replace(
                base,
                friction=base.friction * float(rng.uniform(*FRICTION)),
                payload=base.payload + plan.robot.mass * float(rng.uniform(*PAYLOAD)),
                gain=base.gain * float(rng.uniform(*GAIN)),
                losses=(ContactLoss(limb, when * float(plan.trajectory.time[-1]), LOSS),),
            )
        )
    return tuple(out)


def run_trials(
    plan: ClimbPlan,
    worlds: Sequence[Conditions],
    progress: Callable[[float], None] | None = None,
) -> tuple[Trial, ...]:
    """Simulate a plan in each world."""
    found = []
    for index, conditions in enumerate(worlds):
        run = simulate(plan, conditions)
        slips = len(find_slips(plan, run))
        found.append(Trial(conditions, run.fallen, float(run.time[-1]), slips))
        if progress is not None:
            progress((index + 1) / len(worlds))
    return tuple(found)


def sweep(
    plan: ClimbPlan,
    key: str,
    values: Sequence[float],
    base: Conditions,
    count: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> tuple[SweepPoint, ...]:
    """Plan the same spec anew at each value of a key and simulate it in the same random worlds.

    Raises SpecError for a key or value that the spec does not take.
    """
    points = []
    for index, value in enumerate(values):
        loaded = load_text(plan.spec_text, plan.name, [f"{key}={value!r}"])
        try:
            other = plan_climb(loaded)
        except (NoPlanFound, ReachFailure) as error:
            points.append(SweepPoint(value, (), str(error).splitlines()[0]))
            continue
        worlds = drawn_conditions(other, base, count, seed)

        def part(share: float, done: int = index) -> None:
            if progress is not None:
                progress((done + share) / len(values))

        points.append(SweepPoint(value, run_trials(other, worlds, part), ""))
    return tuple(points)
