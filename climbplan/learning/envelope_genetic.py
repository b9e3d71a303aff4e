"""Envelopes by a genetic algorithm, chapter 5.2.2.2.

A chromosome is the bounds of an envelope; crossover takes each (lower, upper) pair from one parent
or the other. Fitness: a, the share of infeasible terrains that the first stage calls feasible, is
to be small while b, the share of feasible ones that it calls infeasible, stays under delta. The
mutation rate falls over the generations. Several envelopes make one chromosome.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.learning.envelope_box import (
    Envelope,
    EnvelopeSet,
    FirstStageLabels,
    stacked,
    unstacked,
)


@dataclass(frozen=True)
class GeneticOptions:
    """How long and how wildly to search."""

    population: int = 60
    generations: int = 80
    terrains: int = 30  # K, that each individual is tested on in a generation
    delta: float = 0.03  # largest b
    penalty: float = 5.0  # of b beyond delta
    mutation: tuple[float, float] = (0.3, 0.02)  # rate of the first and the last generation
    step: float = 0.15  # of a mutation, in widths of the hull of all first envelopes
    elite: int = 4
    finalists: int = 10  # last generations whose best ones are tested on all training rows


@dataclass(frozen=True)
class GeneticResult:
    """The best envelopes on all training rows, and how fitness went."""

    envelopes: EnvelopeSet
    false_feasible: float  # a on all training rows
    false_infeasible: float  # b
    fitness_mean: Array  # (generations,)
    fitness_spread: Array  # (generations,) standard deviation
    fitness_best: Array  # (generations,)


def evolve(
    labels: FirstStageLabels,
    feasible: BoolArray,
    first: Sequence[EnvelopeSet],
    options: GeneticOptions | None = None,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
) -> GeneticResult:
    """Search from some first sets of envelopes, equally many in each, which mutation spreads.

    labels: whether the first stage is feasible with each of some sets on some rows; feasible: (n,)
    the rows' true labels. The result depends on the seed alone.
    """
    chosen = options or GeneticOptions()
    rng = np.random.default_rng(seed)
    given = [stacked(envelopes) for envelopes in first]
    low = np.min([e.lower for e in given], axis=0)
    high = np.max([e.upper for e in given], axis=0)
    step = chosen.step * np.maximum(high - low, 1e-9)
    population = [given[k % len(given)] for k in range(chosen.population)]
    population = [
        e if k < len(given) else _mutated(e, step, 0.5, rng) for k, e in enumerate(population)
    ]
    means, spreads, bests = [], [], []
    contenders: dict[bytes, Envelope] = {_key(e): e for e in given}
    for generation in range(chosen.generations):
        rows = _balanced(feasible, chosen.terrains, rng)
        fitness = np.array([f.fitness for f in _judged(labels, feasible, population, rows, chosen)])
        means.append(fitness.mean())
        spreads.append(fitness.std())
        bests.append(fitness.max())
        order = np.argsort(-fitness, kind="stable")
        best = population[int(order[0])]
        if generation >= chosen.generations - chosen.finalists:
            contenders[_key(best)] = best
        share = generation / max(chosen.generations - 1, 1)
        rate = chosen.mutation[0] * (1 - share) + chosen.mutation[1] * share
        following = [population[int(k)] for k in order[: chosen.elite]]
        while len(following) < chosen.population:
            parents = [population[int(_tournament(fitness, rng))] for _ in range(2)]
            following.append(_mutated(_crossed(parents[0], parents[1], rng), step, rate, rng))
        population = following
        if report is not None:
            report((generation + 1) / chosen.generations)
    # Fitness on K terrains is noisy: the last word is said on all of them
    finalists = list(contenders.values())
    judged = _judged(labels, feasible, finalists, np.arange(len(feasible)), chosen)
    winner = int(np.argmax([f.fitness for f in judged]))
    return GeneticResult(
        unstacked(finalists[winner]),
        judged[winner].a,
        judged[winner].b,
        np.array(means),
        np.array(spreads),
        np.array(bests),
    )


@dataclass(frozen=True)
class _Fitness:
    fitness: float
    a: float
    b: float


def _judged(
    labels: FirstStageLabels,
    feasible: BoolArray,
    population: Sequence[Envelope],
    rows: IntArray,
    options: GeneticOptions,
) -> list[_Fitness]:
    truth = feasible[rows]
    judged = []
    for called in labels([unstacked(e) for e in population], rows):
        a = float(called[~truth].mean()) if (~truth).any() else 0.0
        b = float((~called[truth]).mean()) if truth.any() else 0.0
        beyond = options.penalty * max(0.0, b - options.delta)
        judged.append(_Fitness(1.0 - a - b - beyond, a, b))
    return judged


def _balanced(feasible: BoolArray, count: int, rng: np.random.Generator) -> IntArray:
    """As many feasible as infeasible rows."""
    parts = [np.flatnonzero(feasible), np.flatnonzero(~feasible)]
    half = [min(len(p), count // 2) for p in parts]
    return np.concatenate(
        [rng.choice(p, h, replace=False) for p, h in zip(parts, half, strict=True)]
    )


def _tournament(fitness: Array, rng: np.random.Generator) -> int:
    rivals = rng.integers(len(fitness), size=3)
    return int(rivals[np.argmax(fitness[rivals])])


def _crossed(a: Envelope, b: Envelope, rng: np.random.Generator) -> Envelope:
    """Uniform, by pairs of bounds."""
    from_a = rng.random(a.lower.shape) < 0.5
    return Envelope(np.where(from_a, a.lower, b.lower), np.where(from_a, a.upper, b.upper))


def _mutated(e: Envelope, step: Array, rate: float, rng: np.random.Generator) -> Envelope:
    moves = [
        np.where(rng.random(step.shape) < rate, step * rng.normal(size=step.shape), 0.0)
        for _ in range(2)
    ]
    ends = e.lower + moves[0], e.upper + moves[1]
    return Envelope(np.clip(np.minimum(*ends), -1, 1), np.clip(np.maximum(*ends), -1, 1))


def _key(e: Envelope) -> bytes:
    return e.lower.tobytes() + e.upper.tobytes()
