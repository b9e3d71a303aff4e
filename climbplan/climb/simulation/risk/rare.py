"""Probabilities of falls that are too small to count: multilevel splitting.

Among worlds as they are drawn few come near to a fall. Those that come nearer than most are taken
as starts of Markov chains that stay as near (preconditioned Crank-Nicolson steps, which leave the
standard normal numbers of worlds as they are distributed), of what these find again the nearest,
and so on: a probability is the product of shares that are not small (Au and Beck 2001; Cerou, Del
Moral, Furon and Guyader 2012).

A first, smaller run chooses the levels. With levels fixed the product is without bias, however few
chains there are and however they depend on each other; how far it scatters is seen from
repetitions that share nothing but the levels. What no chain has come near to, no interval knows:
falls in a corner of the distribution that levels do not lead to are missed, and the probability is
then too low.

How near a world comes: by the largest share of a held toe's friction that is used, then by how far
toes slide and the body departs. This orders worlds; another order would cost more or fewer worlds
but not change what is estimated.
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
from climbplan.climb.plan.promise import CONFIDENCE, interval_of
from climbplan.climb.simulation.statics.outcome import FARTHEST, FELL, SLID, USED
from climbplan.climb.simulation.statics.playback import Steps, played, prepare
from climbplan.climb.simulation.worlds.stated import uncertainty_of
from climbplan.climb.simulation.worlds.uncertainty import Layout, conditions_of, layout_of
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions

REPETITIONS = 6
FEWEST = 1000  # worlds, below which levels have no more than a handful
_KEPT = 0.25  # share of worlds that goes on to the next level
_FIRST = 0.2  # part of the worlds that chooses the levels
_STEPS = 2  # of each chain at each level
_STRIDE = 0.5  # of a chain's steps at first, of 1
_ACCEPTED = (0.25, 0.45)  # shares between which a stride is kept
_MOST_LEVELS = 20
_NEAR = 10.0  # [1/m] on slides and departures
_CHUNK = 25  # worlds that a worker takes at once
_SALT = 0x72617265

Severity = Callable[[Array], Array]  # (B, D) numbers of worlds -> (B,), infinite of falls


@dataclass(frozen=True)
class Rare:
    """What splitting found."""

    seed: int
    worlds: int  # that were played, those that chose the levels included
    levels: Array  # (L,) that worlds had to reach; the last is a fall
    shares: Array  # (R, L) of worlds that reached each from the one before, by repetition

    @property
    def estimates(self) -> Array:
        """(R,) of the probability, by repetition."""
        return np.asarray(self.shares.prod(axis=1))

    @property
    def probability(self) -> float:
        """Of a fall."""
        return float(self.estimates.mean())

    @property
    def error(self) -> float:
        """Standard error of the probability, by how repetitions scatter."""
        return float(self.estimates.std(ddof=1) / np.sqrt(len(self.estimates)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % by Student's t: of the logarithm where all repetitions found falls.

        Where none found any, the upper limit is that of the plain worlds that stood.
        """
        p, error = self.probability, self.error
        times = float(stdtrit(len(self.estimates) - 1, (1 + CONFIDENCE) / 2))
        if p == 0.0:
            return 0.0, interval_of(0, self.worlds)[1]
        if (self.estimates > 0).all():
            factor = float(np.exp(times * error / p))
            return p / factor, min(p * factor, 1.0)
        return max(p - times * error, 0.0), min(p + times * error, 1.0)

    @property
    def effective(self) -> float:
        """How many plain worlds would be as sure."""
        return self.probability * (1 - self.probability) / max(self.error**2, 1e-300)


def rare_falls(
    plan: ClimbPlan,
    base: Conditions,
    worlds: int,
    seed: int,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Rare:
    """The probability of a fall from about so many worlds of the quasi-static engine.

    The same for a seed whatever the number of workers. Raises UsageError for fewer worlds than
    FEWEST, and for robots that the engine does not know.
    """
    layout = layout_of(plan, uncertainty_of(plan))
    run = partial(_severities, plan, prepare(plan, base), base, layout)

    def severity(numbers: Array) -> Array:
        parts = [numbers[k : k + _CHUNK] for k in range(0, len(numbers), _CHUNK)]
        return np.concatenate(Parallel(n_jobs=workers)(delayed(run)(part) for part in parts))

    return split(severity, layout.size, worlds, seed, progress)


def split(
    severity: Severity,
    size: int,
    worlds: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> Rare:
    """The probability that `severity` is infinite of so many standard normal numbers.

    Raises UsageError for fewer worlds than FEWEST.
    """
    if worlds < FEWEST:
        raise UsageError(f"--rare --worlds {worlds}: expected at least {FEWEST} worlds")
    done = 0

    def counted(numbers: Array) -> Array:
        nonlocal done
        found = severity(numbers)
        done += len(numbers)
        if progress is not None:
            progress(min(done / worlds, 1.0))
        return found

    # As many chains as would reach one in a thousand, which is five levels, with these worlds
    first = max(int(_FIRST * worlds / (1 + 4 * _STEPS)), 20)
    levels, strides = _levels(counted, size, first, seed)
    cost = REPETITIONS * (1 + (len(levels) - 1) * _STEPS)
    chains = max((worlds - done) // cost, 4)
    at = [_drawn(seed, r + 1, 0, (chains, size)) for r in range(REPETITIONS)]
    near = np.split(counted(np.concatenate(at)), REPETITIONS)
    shares = np.zeros((REPETITIONS, len(levels)))
    for k, level in enumerate(levels):
        shares[:, k] = [(n >= level).mean() for n in near]
        if k + 1 == len(levels):
            break
        for r in range(REPETITIONS):
            at[r], near[r] = _resampled(at[r], near[r], level, seed, r + 1, k)
        for step in range(_STEPS):
            place = k * _STEPS + step + 1
            moved = [_step(at[r], strides[k], seed, r + 1, place) for r in range(REPETITIONS)]
            alive = [r for r in range(REPETITIONS) if shares[r, : k + 1].all()]
            if not alive:
                break
            found = np.split(counted(np.concatenate([moved[r] for r in alive])), len(alive))
            for r, new in zip(alive, found, strict=True):
                taken = new >= level
                at[r] = np.where(taken[:, None], moved[r], at[r])
                near[r] = np.where(taken, new, near[r])
    return Rare(seed, done, np.array(levels), shares)


def _levels(severity: Severity, size: int, chains: int, seed: int) -> tuple[list[float], Array]:
    """Levels, the last infinite, and strides of the chains that start from each but the last."""
    at = _drawn(seed, 0, 0, (chains, size))
    near = severity(at)
    levels: list[float] = []
    strides, stride = [], _STRIDE
    while len(levels) < _MOST_LEVELS - 1:
        level = float(np.quantile(near, 1 - _KEPT, method="higher"))
        if np.isinf(level) or (levels and level <= levels[-1]):
            break
        levels.append(level)
        k = len(levels) - 1
        at, near = _resampled(at, near, level, seed, 0, k)
        accepted = 0.0
        for step in range(_STEPS):
            moved = _step(at, stride, seed, 0, k * _STEPS + step + 1)
            found = severity(moved)
            taken = found >= level
            accepted += taken.mean() / _STEPS
            at, near = np.where(taken[:, None], moved, at), np.where(taken, found, near)
        strides.append(stride)
        if accepted < _ACCEPTED[0]:
            stride *= 0.7
        elif accepted > _ACCEPTED[1]:
            stride = min(stride * 1.3, 1.0)
    return [*levels, np.inf], np.array(strides)


def _drawn(seed: int, repetition: int, place: int, shape: tuple[int, int]) -> Array:
    rng = np.random.default_rng([_SALT, seed, repetition, place])
    return rng.standard_normal(shape)


def _step(at: Array, stride: float, seed: int, repetition: int, place: int) -> Array:
    """Chains (B, D) a step on, to which standard normal numbers stay what they are."""
    return np.sqrt(1 - stride**2) * at + stride * _drawn(seed, repetition, place, at.shape)


def _resampled(
    at: Array, near: Array, level: float, seed: int, repetition: int, k: int
) -> tuple[Array, Array]:
    """As many chains, started at those that reached a level, each equally often but for one."""
    reached = np.flatnonzero(near >= level)
    if not len(reached):
        return at, near
    rng = np.random.default_rng([_SALT, seed, repetition, k, 1])
    times = np.tile(rng.permutation(reached), -(-len(at) // len(reached)))[: len(at)]
    return at[times], near[times]


def _severities(
    plan: ClimbPlan, steps: Steps, base: Conditions, layout: Layout, numbers: Array
) -> Array:
    """(B,) how near worlds come to a fall."""
    out = np.empty(len(numbers))
    for k, own in enumerate(numbers):
        row = played(plan, steps, conditions_of(base, layout, own))
        near = row[USED] + _NEAR * (row[SLID] + row[FARTHEST])
        out[k] = np.inf if row[FELL] else near
    return out


def rare_dict(rare: Rare) -> dict[str, object]:
    """JSON-ready values."""
    low, high = rare.interval
    return {
        "seed": rare.seed,
        "worlds": rare.worlds,
        "probability": rare.probability,
        "lower": low,
        "upper": high,
        "interval": "repetitions of splitting, Student's t, 95 %",
        "effective": rare.effective,
        "levels": [float(level) for level in rare.levels[:-1]],
        "shares": rare.shares.mean(axis=0).tolist(),
        "repetitions": rare.estimates.tolist(),
    }


def rare_told(rare: Rare) -> list[str]:
    """The estimate in lines."""
    low, high = rare.interval
    count = f"{rare.worlds} worlds in {len(rare.levels)} levels, {len(rare.shares)} repetitions"
    return [
        f"falls (statics): {rare.probability:.2e}, 95 % interval {low:.2e} to {high:.2e}",
        f"  splitting, {count}: as sure as {rare.effective:.0f} plain worlds",
        "  ways to fall that no chain came near to are not in it",
    ]
