"""Estimate small probabilities of a fall by multilevel splitting (subset simulation).

A severity orders worlds, and a fall has infinite severity. The probability of a fall is the product
of conditional probabilities of increasing severity levels, none of which is small (Au and Beck
2001; Cerou, Del Moral, Furon and Guyader 2012). Samples above a level are the starts of Markov
chains that stay above it. Their preconditioned Crank-Nicolson steps leave the standard normal
distribution of the worlds' numbers invariant.

A pilot run chooses the levels. With fixed levels the product is unbiased, for any number of chains
and any dependence between them. Independent repetitions with the same levels show its variance.
Falls in a part of the distribution that no level leads to are missed; the estimate is then too low.

The severity is the largest used fraction of friction of a pressing toe, plus a weight times slip
and deviation of the body. Another severity would change the variance but not the expectation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from joblib import Parallel, delayed
from scipy.special import stdtrit

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import CONFIDENCE, compute_interval
from climbplan.climb.simulation.implicit_dynamics.engine import (
    PreparedMotion,
    prepare_steps,
    simulate_steps,
)
from climbplan.climb.simulation.implicit_dynamics.outcome import (
    FRICTION_USE,
    HAS_FALLEN,
    MAX_DEVIATION,
    MAX_SLIP,
)
from climbplan.climb.simulation.worlds.uncertainty import (
    ScenarioLayout,
    build_layout,
    sample_conditions,
)
from climbplan.climb.simulation.worlds.uncertainty_spec import read_uncertainty
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions

NUM_REPETITIONS = 6
MIN_WORLDS = 1000  # of an estimate: with fewer a level has a handful
_LEVEL_FRACTION = 0.25  # of the samples that reach the next level
_PILOT_FRACTION = 0.2  # of the worlds, for the pilot run
_STEPS_PER_LEVEL = 2  # steps of each chain at each level
_INITIAL_STRIDE = 0.5  # of a chain's first steps, at most 1
_ACCEPTANCE_RANGE = (0.25, 0.45)  # acceptance rates between which a stride is unchanged
_MAX_LEVELS = 20
_DISTANCE_WEIGHT = 10.0  # [1/m] on slides and departures
_CHUNK_SIZE = 25  # worlds that a worker takes at once
_SALT = 0x72617265

Severity = Callable[[Array], Array]  # (B, D) numbers of worlds -> (B,), infinite of falls


@dataclass(frozen=True)
class RareEventEstimate:
    """An estimate by multilevel splitting, with L levels and R repetitions."""

    seed: int
    worlds: int  # simulated, the pilot run included
    levels: Array  # (L,) severities; the last is infinite, a fall
    pass_fractions: Array  # (R, L) of worlds above the level before, which reach a level

    @property
    def estimates(self) -> Array:
        """Estimates (R,) of the probability, by repetition."""
        return np.asarray(self.pass_fractions.prod(axis=1))

    @property
    def probability(self) -> float:
        """Probability of a fall, the mean of the repetitions."""
        return float(self.estimates.mean())

    @property
    def error(self) -> float:
        """Standard error of the probability, by the variance of the repetitions."""
        return float(self.estimates.std(ddof=1) / np.sqrt(len(self.estimates)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval by Student's t, of the logarithm if all repetitions found falls.

        If none found any, the upper limit is that of plain Monte Carlo without falls.
        """
        p, error = self.probability, self.error
        quantile = float(stdtrit(len(self.estimates) - 1, (1 + CONFIDENCE) / 2))
        if p == 0.0:
            return 0.0, compute_interval(0, self.worlds)[1]
        if (self.estimates > 0).all():
            factor = float(np.exp(quantile * error / p))
            return p / factor, min(p * factor, 1.0)
        return max(p - quantile * error, 0.0), min(p + quantile * error, 1.0)

    @property
    def equivalent_worlds(self) -> float:
        """Number of worlds with which plain Monte Carlo would have the same standard error."""
        return self.probability * (1 - self.probability) / max(self.error**2, 1e-300)


def estimate_fall_probability(
    plan: ClimbPlan,
    base: Conditions,
    worlds: int,
    seed: int,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> RareEventEstimate:
    """Estimate the probability of a fall with the quasi-static engine.

    Args:
        plan: The plan.
        base: Conditions that all worlds share.
        worlds: Approximate number of simulated worlds, at least MIN_WORLDS.
        seed: Seed of all draws.
        workers: Number of processes; results do not depend on it.
        progress: Called with the fraction that is done.

    Raises:
        UsageError: There are too few worlds, or the engine has no model of the robot.
    """
    layout = build_layout(plan, read_uncertainty(plan))
    run = partial(_compute_severities, plan, prepare_steps(plan, base), base, layout)

    def severity(numbers: Array) -> Array:
        batches = [numbers[k : k + _CHUNK_SIZE] for k in range(0, len(numbers), _CHUNK_SIZE)]
        return np.concatenate(Parallel(n_jobs=workers)(delayed(run)(batch) for batch in batches))

    return run_multilevel_splitting(severity, layout.size, worlds, seed, progress)


def run_multilevel_splitting(
    severity: Severity,
    size: int,
    worlds: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> RareEventEstimate:
    """Estimate the probability that the severity of standard normal numbers is infinite.

    Args:
        severity: Maps numbers (B, D) to severities (B,).
        size: D.
        worlds: Approximate number of evaluations, at least MIN_WORLDS.
        seed: Seed of all draws.
        progress: Called with the fraction that is done.

    Raises:
        UsageError: There are fewer than MIN_WORLDS worlds.
    """
    if worlds < MIN_WORLDS:
        raise UsageError(f"--rare --worlds {worlds}: expected at least {MIN_WORLDS} worlds")
    count_severity = _CountedSeverity(severity, worlds, progress)
    # As many chains as reach a probability of 1e-3, five levels, with the worlds of the pilot run
    num_pilot_chains = max(int(_PILOT_FRACTION * worlds / (1 + 4 * _STEPS_PER_LEVEL)), 20)
    levels, strides = _choose_levels(count_severity, size, num_pilot_chains, seed)
    cost = NUM_REPETITIONS * (1 + (len(levels) - 1) * _STEPS_PER_LEVEL)
    chains = max((worlds - count_severity.num_worlds_done) // cost, 4)
    states = [_draw_normal(seed, r + 1, 0, (chains, size)) for r in range(NUM_REPETITIONS)]
    severities = np.split(count_severity(np.concatenate(states)), NUM_REPETITIONS)
    pass_fractions = np.zeros((NUM_REPETITIONS, len(levels)))
    for k, level in enumerate(levels):
        pass_fractions[:, k] = [
            (severity_of_chains >= level).mean() for severity_of_chains in severities
        ]
        if k + 1 == len(levels):
            break
        for r in range(NUM_REPETITIONS):
            states[r], severities[r] = _resample_chains(
                states[r], severities[r], level, seed, r + 1, k
            )
        for step in range(_STEPS_PER_LEVEL):
            step_index = k * _STEPS_PER_LEVEL + step + 1
            proposed = [
                _propose_step(states[r], strides[k], seed, r + 1, step_index)
                for r in range(NUM_REPETITIONS)
            ]
            active = [r for r in range(NUM_REPETITIONS) if pass_fractions[r, : k + 1].all()]
            if not active:
                break
            proposed_severities = np.split(
                count_severity(np.concatenate([proposed[r] for r in active])), len(active)
            )
            for r, severity_of_proposal in zip(active, proposed_severities, strict=True):
                is_accepted = severity_of_proposal >= level
                states[r] = np.where(is_accepted[:, None], proposed[r], states[r])
                severities[r] = np.where(is_accepted, severity_of_proposal, severities[r])
    num_worlds_done = count_severity.num_worlds_done
    return RareEventEstimate(seed, num_worlds_done, np.array(levels), pass_fractions)


@dataclass
class _CountedSeverity:
    """A severity that counts and reports the worlds that it was evaluated in."""

    severity: Severity
    worlds: int  # that are expected
    progress: Callable[[float], None] | None
    num_worlds_done: int = 0

    def __call__(self, numbers: Array) -> Array:
        severities = self.severity(numbers)
        self.num_worlds_done += len(numbers)
        if self.progress is not None:
            self.progress(min(self.num_worlds_done / self.worlds, 1.0))
        return severities


def _choose_levels(
    severity: Severity, size: int, chains: int, seed: int
) -> tuple[list[float], Array]:
    """Choose levels, the last infinite, and strides of the chains from each but the last."""
    states = _draw_normal(seed, 0, 0, (chains, size))
    severities = severity(states)
    levels: list[float] = []
    strides, stride = [], _INITIAL_STRIDE
    while len(levels) < _MAX_LEVELS - 1:
        level = float(np.quantile(severities, 1 - _LEVEL_FRACTION, method="higher"))
        if np.isinf(level) or (levels and level <= levels[-1]):
            break
        levels.append(level)
        k = len(levels) - 1
        states, severities = _resample_chains(states, severities, level, seed, 0, k)
        acceptance = 0.0
        for step in range(_STEPS_PER_LEVEL):
            proposed = _propose_step(states, stride, seed, 0, k * _STEPS_PER_LEVEL + step + 1)
            proposed_severities = severity(proposed)
            is_accepted = proposed_severities >= level
            acceptance += is_accepted.mean() / _STEPS_PER_LEVEL
            states, severities = (
                np.where(is_accepted[:, None], proposed, states),
                np.where(is_accepted, proposed_severities, severities),
            )
        strides.append(stride)
        if acceptance < _ACCEPTANCE_RANGE[0]:
            stride *= 0.7
        elif acceptance > _ACCEPTANCE_RANGE[1]:
            stride = min(stride * 1.3, 1.0)
    return [*levels, np.inf], np.array(strides)


def _draw_normal(seed: int, repetition: int, step_index: int, shape: tuple[int, int]) -> Array:
    rng = np.random.default_rng([_SALT, seed, repetition, step_index])
    return rng.standard_normal(shape)


def _propose_step(
    states: Array, stride: float, seed: int, repetition: int, step_index: int
) -> Array:
    """Propose a preconditioned Crank-Nicolson step of chains (B, D)."""
    return np.sqrt(1 - stride**2) * states + stride * _draw_normal(
        seed, repetition, step_index, states.shape
    )


def _resample_chains(
    states: Array, severities: Array, level: float, seed: int, repetition: int, k: int
) -> tuple[Array, Array]:
    """Resample as many chains from those above a level, each as often as any other up to one."""
    reached = np.flatnonzero(severities >= level)
    if not len(reached):
        return states, severities
    rng = np.random.default_rng([_SALT, seed, repetition, k, 1])
    chosen = np.tile(rng.permutation(reached), -(-len(states) // len(reached)))[: len(states)]
    return states[chosen], severities[chosen]


def _compute_severities(
    plan: ClimbPlan, steps: PreparedMotion, base: Conditions, layout: ScenarioLayout, numbers: Array
) -> Array:
    """Simulate worlds (B, D) and compute their severities (B,)."""
    severities = np.empty(len(numbers))
    for k, world_numbers in enumerate(numbers):
        row = simulate_steps(plan, steps, sample_conditions(base, layout, world_numbers))
        severity = row[FRICTION_USE] + _DISTANCE_WEIGHT * (row[MAX_SLIP] + row[MAX_DEVIATION])
        severities[k] = np.inf if row[HAS_FALLEN] else severity
    return severities


def build_rare_dict(estimate: RareEventEstimate) -> dict[str, object]:
    """Build the JSON-ready values of an estimate."""
    low, high = estimate.interval
    return {
        "seed": estimate.seed,
        "worlds": estimate.worlds,
        "probability": estimate.probability,
        "lower": low,
        "upper": high,
        "interval": "repetitions of splitting, Student's t, 95 %",
        "effective": estimate.equivalent_worlds,
        "levels": [float(level) for level in estimate.levels[:-1]],
        "shares": estimate.pass_fractions.mean(axis=0).tolist(),
        "repetitions": estimate.estimates.tolist(),
    }


def format_rare_event(estimate: RareEventEstimate) -> list[str]:
    """Format an estimate as lines of text."""
    low, high = estimate.interval
    count = (
        f"{estimate.worlds} worlds in {len(estimate.levels)} levels, "
        f"{len(estimate.pass_fractions)} repetitions"
    )
    return [
        f"falls (statics): {estimate.probability:.2e}, 95 % interval {low:.2e} to {high:.2e}",
        f"  splitting, {count}: as sure as {estimate.equivalent_worlds:.0f} plain worlds",
        "  ways to fall that no chain came near to are not in it",
    ]
