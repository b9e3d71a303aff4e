"""Largest boxes against enumeration, clusters, and the genetic search on a known problem."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from climbplan.learning.envelope_box import Envelope, EnvelopeSet, compute_bounding_box
from climbplan.learning.envelope_clustering import find_largest_box, fit_clusters
from climbplan.learning.envelope_genetic import GeneticOptions, run_genetic_search


def _enumerated(centre: np.ndarray, bad: np.ndarray, good: np.ndarray) -> float:
    """The largest relative width by trying every axis for every excluded point."""
    low, high = np.minimum(good.min(0), centre), np.maximum(good.max(0), centre)
    inside = bad[((bad >= low) & (bad <= high)).all(1)]
    best = 0.0
    for axes in itertools.product(range(len(centre)), repeat=len(inside)):
        a, b = low.copy(), high.copy()
        for point, axis in zip(inside, axes, strict=True):
            if point[axis] < centre[axis]:
                a[axis] = max(a[axis], point[axis])
            else:
                b[axis] = min(b[axis], point[axis])
        best = max(best, float(((b - a) / (high - low)).sum()))
    return best


@pytest.mark.parametrize("seed", range(8))
def test_largest_box_is_the_enumerated_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    good, bad = rng.uniform(-1, 1, (30, 3)), rng.uniform(-1, 1, (6, 3))
    centre = rng.uniform(-0.3, 0.3, 3)
    box, gap = find_largest_box(centre, bad, good)
    span = np.maximum(good.max(0), centre) - np.minimum(good.min(0), centre)
    assert gap <= 1e-3
    assert ((box.upper - box.lower) / span).sum() == pytest.approx(
        _enumerated(centre, bad, good), abs=1e-3
    )
    assert not ((bad > box.lower) & (bad < box.upper)).all(axis=1).any()
    assert ((box.lower <= centre) & (centre <= box.upper)).all()


def test_two_clusters_are_told_apart() -> None:
    rng = np.random.default_rng(0)
    middles = np.array([[-0.6, 0.1], [0.5, -0.2]])
    good = np.concatenate([m + 0.05 * rng.normal(size=(80, 2)) for m in middles])[:, None]
    bad = rng.uniform(-0.1, 0.1, (40, 1, 2))
    found = fit_clusters(good, bad, envelopes=2)
    centres = sorted(float(c.centre[0, 0]) for c in found)
    assert centres == pytest.approx([-0.6, 0.5], abs=0.03)
    for cluster in found:
        assert not cluster.envelope.contains(bad).any()
        assert cluster.kept.sum() >= 70
        assert cluster.envelope.contains(good)[cluster.kept].all()


def _disc_labels(sets: Sequence[EnvelopeSet], rows: np.ndarray) -> list[np.ndarray]:
    """Row k is the interval [k, k + 1] / 20: feasible with a box of the set that meets it."""
    low = rows / 20
    return [
        np.any([(e.lower[0, 0] <= low + 0.05) & (e.upper[0, 0] >= low) for e in boxes], axis=0)
        for boxes in sets
    ]


def test_genetic_search_finds_the_interval() -> None:
    feasible = np.zeros(20, bool)
    feasible[6:13] = True
    first = [(Envelope(np.array([[0.0]]), np.array([[1.0]])),)]
    options = GeneticOptions(population=20, generations=25, terrains=14)
    found = run_genetic_search(_disc_labels, feasible, first, options, seed=3)
    assert found.false_infeasible <= options.delta
    assert found.false_feasible <= 2 / 13
    assert found.fitness_best[-1] > found.fitness_best[0]
    again = run_genetic_search(_disc_labels, feasible, first, options, seed=3)
    np.testing.assert_array_equal(found.envelopes[0].lower, again.envelopes[0].lower)


def test_genetic_search_of_two_boxes() -> None:
    """Two separate intervals: one box alone would hold what is between them."""
    feasible = np.zeros(20, bool)
    feasible[[2, 3, 4, 14, 15, 16]] = True
    boxes = [Envelope(np.array([[a]]), np.array([[b]])) for a, b in ((0.0, 0.5), (0.5, 1.0))]
    options = GeneticOptions(population=20, generations=25, terrains=14)
    found = run_genetic_search(_disc_labels, feasible, [tuple(boxes)], options, seed=1)
    assert len(found.envelopes) == 2
    assert found.false_infeasible <= options.delta
    assert found.false_feasible <= 4 / 14  # each box may touch its neighbours


def test_exterior_is_tight() -> None:
    points = np.random.default_rng(2).normal(size=(10, 2, 3))
    box = compute_bounding_box(points)
    assert box.contains(points).all()
    for axis in np.ndindex(2, 3):
        assert (points[(slice(None), *axis)] == box.lower[axis]).any()
