"""Worlds drawn at random about the nominal one, and the share of plans that fall in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from climbplan.simulation.conditions import Conditions, FrictionLoss

FRICTION = (0.5, 1.05)  # factor on the terrain's coefficients
PAYLOAD = (0.0, 0.02)  # of the robot's mass
GAIN = (0.95, 1.05)  # factor on joint stiffness
LOSS = 0.2  # [s] for which one toe has no friction, at a time and limb drawn
_Z = 1.96


@dataclass(frozen=True)
class RandomRun:
    """One random run."""

    conditions: Conditions
    fallen: bool
    time: float  # [s] at its end, of the plan
    slips: int


@dataclass(frozen=True)
class FallRate:
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
class ConditionsDistribution:
    """What worlds are drawn about."""

    base: Conditions
    limbs: int
    mass: float  # [kg] of the robot
    duration: float  # [s] of the plan
    loss: float = LOSS  # [s]
    max_backlash: float = 0.0  # [rad]


def sample_conditions(
    distribution: ConditionsDistribution, count: int, seed: int
) -> tuple[Conditions, ...]:
    """Return worlds; the same for every plan of the same robot, but for the duration.

    Whether backlash is drawn does not change the rest.
    """
    out, base = [], distribution.base
    for child in np.random.SeedSequence(seed).spawn(count):
        rng = np.random.default_rng(child)
        limb, when = int(rng.integers(distribution.limbs)), float(rng.uniform(0.05, 0.95))
        world = replace(
            base,
            friction=base.friction * float(rng.uniform(*FRICTION)),
            payload=base.payload + distribution.mass * float(rng.uniform(*PAYLOAD)),
            gain=base.gain * float(rng.uniform(*GAIN)),
            losses=(FrictionLoss(limb, when * distribution.duration, distribution.loss),),
        )
        more = float(rng.uniform(0.0, 1.0)) * distribution.max_backlash
        out.append(replace(world, backlash=base.backlash + more))
    return tuple(out)


def run_trials(
    trial: Callable[[Conditions], RandomRun],
    worlds: Sequence[Conditions],
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> tuple[RandomRun, ...]:
    """Simulate in each world; the outcome does not depend on the number of workers."""
    trials: list[RandomRun] = []
    work = Parallel(n_jobs=jobs, return_as="generator")(delayed(trial)(w) for w in worlds)
    for outcome in work:
        trials.append(outcome)
        if progress is not None:
            progress(len(trials) / len(worlds))
    return tuple(trials)
