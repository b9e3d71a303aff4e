"""Candidates to checked answers on the cart-pole, by every local method."""

from __future__ import annotations

from functools import cache

import cart_pole_data as data
import numpy as np
import pytest
from cart_pole import random_theta

from climbplan.arrays import Array
from climbplan.learning.library import Library
from climbplan.learning.neighbours import NearestCentroids, NearestProblems
from climbplan.learning.strategy import Candidate, Strategy
from climbplan.methods.pipeline import (
    CheckedPoint,
    Local,
    PipelineOptions,
    PipelineResult,
    run_pipeline,
)
from climbplan.program import Instance, Program
from climbplan.solvers.registry import solve

PROGRAM = data.damped()
TOLERANCE = 1e-5


@cache
def _train() -> Library:
    return data.library(PROGRAM, 150, 0)[0]


@cache
def _tests() -> tuple[Library, list[dict[str, Array]]]:
    return data.library(PROGRAM, 30, 1)


def _run(theta: dict[str, Array], strategy: Strategy, most: int = 10) -> PipelineResult:
    options = PipelineOptions(tolerance=TOLERANCE)
    candidates = strategy.candidates(data.features(theta), most)
    return run_pipeline(PROGRAM.instantiate(theta), candidates, options)


def _solve(local: Local, count: int = 3) -> list[PipelineResult]:
    near = NearestProblems.of(_train(), "strategies")
    options = PipelineOptions(local=local, tolerance=TOLERANCE)
    return [
        run_pipeline(PROGRAM.instantiate(theta), near.candidates(data.features(theta), 6), options)
        for theta in _tests()[1][:count]
    ]


def test_neighbours_solve_new_cart_poles() -> None:
    reference, thetas = _tests()
    assert len(_train().strategies) > 10
    near = NearestProblems.of(_train(), "strategies")
    results = [_run(theta, near) for theta in thetas]
    assert sum(r.solved for r in results) >= 0.95 * len(thetas)
    ratio = np.array([r.objective for r in results]) / reference.objective
    assert (ratio <= 1.01).mean() >= 0.8
    for theta, result in zip(thetas, results, strict=True):
        if result.x is not None:
            report = PROGRAM.check(result.x, theta)
            assert report.passed(TOLERANCE)
            assert report.objective == pytest.approx(result.objective)
            assert result.tried[result.winner].objective == result.objective


def test_published_centroids_work_too() -> None:
    thetas = _tests()[1][:10]
    results = [_run(theta, NearestCentroids.of(_train())) for theta in thetas]
    assert sum(r.solved for r in results) >= 6


@pytest.mark.slow
def test_within_one_percent_of_the_optimum() -> None:
    near = NearestProblems.of(_train(), "strategies")
    close = 0
    for theta in _tests()[1][:4]:
        exact = solve(PROGRAM.instantiate(theta), "minlp-scip", gap=1e-3, time_limit=20.0)
        assert exact.objective is not None
        found = _run(theta, near)
        assert found.objective >= exact.objective * (1 - 2e-3)
        close += found.objective <= 1.01 * exact.objective
    assert close >= 3


def test_same_answers_twice() -> None:
    near = NearestProblems.of(_train(), "mixed")
    for theta in _tests()[1][:3]:
        first, second = _run(theta, near), _run(theta, near)
        assert first.winner == second.winner
        assert first.objective == second.objective
        assert [t.word for t in first.tried] == [t.word for t in second.tried]


def test_local_methods_agree_where_both_hold() -> None:
    for ours, other in zip(_solve("sqp"), _solve("ipopt"), strict=True):
        assert ours.solved == other.solved
        if ours.solved:
            assert ours.objective == pytest.approx(other.objective, rel=1e-2)


def test_envelopes_alone_seldom_hold() -> None:
    for result in _solve("envelopes"):
        for tried in result.tried:
            assert tried.passed or tried.word.split(",")[0] in ("contradiction", "failed", "solved")


def _impossible(candidate: Candidate) -> Candidate:
    """In contact with both walls at once, at every step."""
    values = candidate.values.copy()
    touch = PROGRAM.variables["touch"]
    values[touch.start : touch.stop] = 1.0
    return Candidate(values, candidate.alternatives, candidate.start)


def _good() -> tuple[Instance, list[Candidate]]:
    reference, thetas = _tests()
    return PROGRAM.instantiate(thetas[0]), [
        Candidate(reference.points[0], data.NONE, reference.points[0]),
    ]


def test_candidates_that_cannot_hold_are_dropped_fast() -> None:
    instance, good = _good()
    result = run_pipeline(instance, [_impossible(good[0]), *good])
    assert result.winner == 1
    assert result.tried[0].word == "contradiction"
    assert result.tried[0].programs <= 2
    assert not result.tried[0].passed
    assert [t.word for t in result.tried].count("contradiction") == 1


def test_stops_at_the_first_or_at_one_that_is_good_enough() -> None:
    instance, good = _good()
    three = [*good, *good, *good]
    assert len(run_pipeline(instance, three, PipelineOptions(stop="first")).tried) == 1
    assert len(run_pipeline(instance, three, PipelineOptions(prune=False)).tried) == 3
    assert not run_pipeline(instance, three, PipelineOptions(time_limit=0.0)).tried
    cost = run_pipeline(instance, good).objective
    assert len(run_pipeline(instance, three, PipelineOptions(good_enough=cost * 1.01)).tried) == 1
    assert len(run_pipeline(instance, three, PipelineOptions(good_enough=cost * 0.99)).tried) == 3


def test_pruning_keeps_the_best() -> None:
    near = NearestProblems.of(_train(), "strategies")
    for theta in _tests()[1][:8]:
        instance, found = PROGRAM.instantiate(theta), near.candidates(data.features(theta), 10)
        results = [
            run_pipeline(instance, found, PipelineOptions(tolerance=TOLERANCE, prune=prune))
            for prune in (True, False)
        ]
        assert results[0].objective == pytest.approx(results[1].objective, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, -100.0])
def test_a_candidate_that_costs_more_is_given_up(offset: float) -> None:
    p = Program("hyperbola")
    x = p.continuous("x", (2,), 0.1, 9.0)
    far = p.binary("far", (1,))
    p.equal("product", x[:1] * x[1:] - 4.0)
    p.when("far", far[0], x[:1], lower=4.0)
    p.minimise("cost", np.sum(x**2) + offset)
    near, away = np.array([3.0, 1.0, 0.0]), np.array([4.0, 1.0, 1.0])
    candidates = [Candidate(x, data.NONE, x) for x in (near, away)]
    result = run_pipeline(p.instantiate(), candidates, PipelineOptions())
    assert result.objective == pytest.approx(8.0 + offset, abs=1e-4)
    assert [t.word for t in result.tried] == ["converged", "cutoff"]
    whole = run_pipeline(p.instantiate(), candidates, PipelineOptions(prune=False))
    assert whole.tried[1].objective == pytest.approx(17.0 + offset, abs=1e-4)


def test_the_check_has_the_last_word() -> None:
    instance, good = _good()

    def never(_: Instance, x: Array) -> CheckedPoint:
        return CheckedPoint(False, 0.0, x, "refused")

    result = run_pipeline(instance, good, check=never)
    assert not result.solved
    assert result.objective == np.inf
    assert "refused" in result.tried[0].word


def test_random_problems_never_give_unchecked_answers() -> None:
    rng = np.random.default_rng(9)
    near = NearestProblems.of(_train(), "points")
    for _ in range(10):
        theta = random_theta(rng)
        theta["start"] = theta["start"] * rng.uniform(0.5, 2.5)  # beyond what was learned
        result = _run(theta, near, 4)
        if result.x is not None:
            assert PROGRAM.instantiate(theta).violation(result.x) <= TOLERANCE
