"""Envelopes by a genetic algorithm, chapter 5.2.2.2.

A chromosome is the bounds of an envelope; crossover takes each (lower, upper) pair from one parent
or the other. The fitness falls with the fraction a of infeasible terrains that the first stage
classifies as feasible, while the fraction b of feasible ones classified as infeasible stays below
delta. The mutation rate falls over the generations. Several envelopes form one chromosome.

Chapter numbers are those of X. Lin (UCLA 2022).
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
    stack_envelopes,
    unstack_envelopes,
)


@dataclass(frozen=True)
class GeneticOptions:
    """Options of the genetic algorithm."""

    population: int = 60
    generations: int = 80
    terrains: int = 30  # K, number of terrains for each individual in a generation
    delta: float = 0.03  # largest b
    penalty: float = 5.0  # weight of b beyond delta
    mutation: tuple[float, float] = (0.3, 0.02)  # rate of the first and the last generation
    step: float = 0.15  # of a mutation, in widths of the hull of all first envelopes
    elite: int = 4
    finalists: int = 10  # last generations whose best ones are tested on all training rows


@dataclass(frozen=True)
class GeneticResult:
    """The best envelopes on all training rows, and the history of the fitness."""

    envelopes: EnvelopeSet
    false_feasible: float  # a on all training rows
    false_infeasible: float  # b
    fitness_mean: Array  # (generations,)
    fitness_spread: Array  # (generations,) standard deviation
    fitness_best: Array  # (generations,)


def run_genetic_search(
    labels: FirstStageLabels,
    feasible: BoolArray,
    first: Sequence[EnvelopeSet],
    options: GeneticOptions | None = None,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
) -> GeneticResult:
    """Search from some first sets of envelopes, equally many in each, which mutation spreads.

    The result depends on the seed alone.

    Args:
        labels: Returns whether the first stage is feasible with each of some sets on some rows.
        feasible: (n,) true labels of the rows.
        first: First sets of envelopes.
        options: Options of the algorithm.
        seed: Seed of the random numbers.
        report: Progress callback.
    """
    chosen = options or GeneticOptions()
    rng = np.random.default_rng(seed)
    initial = [stack_envelopes(envelopes) for envelopes in first]
    low = np.min([e.lower for e in initial], axis=0)
    high = np.max([e.upper for e in initial], axis=0)
    step = chosen.step * np.maximum(high - low, 1e-9)
    population = _spread_population(initial, chosen.population, step, rng)
    history: list[tuple[float, float, float]] = []
    contenders: dict[bytes, Envelope] = {_encode_key(e): e for e in initial}
    for generation in range(chosen.generations):
        rows = _sample_balanced(feasible, chosen.terrains, rng)
        fitness = np.array(
            [f.fitness for f in _evaluate_population(labels, feasible, population, rows, chosen)]
        )
        history.append((fitness.mean(), fitness.std(), fitness.max()))
        order = np.argsort(-fitness, kind="stable")
        best = population[int(order[0])]
        if generation >= chosen.generations - chosen.finalists:
            contenders[_encode_key(best)] = best
        progress = generation / max(chosen.generations - 1, 1)
        rate = chosen.mutation[0] * (1 - progress) + chosen.mutation[1] * progress
        elite = [population[int(k)] for k in order[: chosen.elite]]
        num_children = max(chosen.population - len(elite), 0)
        population = elite + [
            _mutate(_select_and_cross(population, fitness, rng), step, rate, rng)
            for _ in range(num_children)
        ]
        if report is not None:
            report((generation + 1) / chosen.generations)
    # Fitness on K terrains is noisy, so finalists are compared on all of them
    finalists = list(contenders.values())
    evaluated = _evaluate_population(labels, feasible, finalists, np.arange(len(feasible)), chosen)
    best_index = int(np.argmax([f.fitness for f in evaluated]))
    return GeneticResult(
        unstack_envelopes(finalists[best_index]),
        evaluated[best_index].a,
        evaluated[best_index].b,
        *np.array(history).reshape(-1, 3).T,
    )


@dataclass(frozen=True)
class _Fitness:
    """Fitness of an individual and its error fractions."""

    fitness: float
    a: float
    b: float


def _evaluate_population(
    labels: FirstStageLabels,
    feasible: BoolArray,
    population: Sequence[Envelope],
    rows: IntArray,
    options: GeneticOptions,
) -> list[_Fitness]:
    """Evaluate the fitness of a population on rows."""
    truth = feasible[rows]
    evaluated = []
    for classified in labels([unstack_envelopes(e) for e in population], rows):
        a = float(classified[~truth].mean()) if (~truth).any() else 0.0
        b = float((~classified[truth]).mean()) if truth.any() else 0.0
        excess = options.penalty * max(0.0, b - options.delta)
        evaluated.append(_Fitness(1.0 - a - b - excess, a, b))
    return evaluated


def _spread_population(
    initial: Sequence[Envelope], count: int, step: Array, rng: np.random.Generator
) -> list[Envelope]:
    """Return the first individuals, and mutated copies of them up to a count."""
    population = [initial[k % len(initial)] for k in range(count)]
    return [e if k < len(initial) else _mutate(e, step, 0.5, rng) for k, e in enumerate(population)]


def _sample_balanced(feasible: BoolArray, count: int, rng: np.random.Generator) -> IntArray:
    """Sample as many feasible as infeasible rows."""
    classes = [np.flatnonzero(feasible), np.flatnonzero(~feasible)]
    half = [min(len(p), count // 2) for p in classes]
    return np.concatenate(
        [rng.choice(p, h, replace=False) for p, h in zip(classes, half, strict=True)]
    )


def _select_and_cross(
    population: Sequence[Envelope], fitness: Array, rng: np.random.Generator
) -> Envelope:
    """Cross two parents that tournaments select."""
    parents = [population[_select_by_tournament(fitness, rng)] for _ in range(2)]
    return _cross_over(parents[0], parents[1], rng)


def _select_by_tournament(fitness: Array, rng: np.random.Generator) -> int:
    """Select an individual by a tournament of three."""
    rivals = rng.integers(len(fitness), size=3)
    return int(rivals[np.argmax(fitness[rivals])])


def _cross_over(a: Envelope, b: Envelope, rng: np.random.Generator) -> Envelope:
    """Combine two parents uniformly by pairs of bounds."""
    from_a = rng.random(a.lower.shape) < 0.5
    return Envelope(np.where(from_a, a.lower, b.lower), np.where(from_a, a.upper, b.upper))


def _mutate(e: Envelope, step: Array, rate: float, rng: np.random.Generator) -> Envelope:
    """Mutate the bounds of an individual."""
    moves = [
        np.where(rng.random(step.shape) < rate, step * rng.normal(size=step.shape), 0.0)
        for _ in range(2)
    ]
    ends = e.lower + moves[0], e.upper + moves[1]
    return Envelope(np.clip(np.minimum(*ends), -1, 1), np.clip(np.maximum(*ends), -1, 1))


def _encode_key(e: Envelope) -> bytes:
    """Return a key of an individual."""
    return e.lower.tobytes() + e.upper.tobytes()
