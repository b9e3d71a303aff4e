"""What a comparison of a strategy with the default method comes to."""

from __future__ import annotations

import pytest

from climbplan.api.strategy_comparison import Attempt, ComparedProblem, StrategyComparison


def attempt(seconds: float, cost: float | None, is_proved: bool = False) -> Attempt:
    return Attempt(seconds, seconds, cost, is_proved)


def compare(*rows: tuple[Attempt, Attempt, Attempt]) -> StrategyComparison:
    return StrategyComparison("forest", "auto", tuple(ComparedProblem(*row) for row in rows))


def test_integers_first_are_named_where_they_are_faster_with_the_same_proof() -> None:
    outcome = compare(
        (attempt(1.0, 2.0, True), attempt(0.25, 2.0, True), attempt(0.1, 2.001)),
        (attempt(1.0, 1.0, True), attempt(0.25, 1.0, True), attempt(0.1, 1.0)),
    )
    assert outcome.pays
    assert outcome.summarise("proposed").speedup == pytest.approx(4.0)
    assert outcome.verdict.startswith("use the model with method auto")
    assert "4.0 times as fast with the same proof" in outcome.verdict
    assert "method forest, without a proof, is 10.0 times as fast; 2 of 2" in outcome.verdict
    figures = outcome.as_dict()
    assert figures["integers_first_proved"] == 2
    assert figures["strategy_worst_cost_ratio"] == pytest.approx(1.0005)


def test_a_strategy_alone_pays_if_it_is_faster_at_the_same_cost() -> None:
    outcome = compare((attempt(1.0, 2.0, True), attempt(1.1, 2.0, True), attempt(0.2, 2.0)))
    assert outcome.pays
    assert outcome.verdict.startswith("use forest: 5.0 times as fast; 1 of 1 problems")


def test_a_dearer_answer_does_not_pay() -> None:
    outcome = compare((attempt(1.0, 2.0, True), attempt(1.25, 2.0, True), attempt(0.1, 2.1)))
    assert not outcome.pays
    assert outcome.verdict.startswith("use auto without the model")
    assert "1.2 times as slow" in outcome.verdict
    assert "cost at most 1.050 times as high" in outcome.verdict


def test_problems_without_an_answer_are_counted() -> None:
    outcome = compare((attempt(1.0, 2.0, True), attempt(1.0, 2.0, True), attempt(1.5, None)))
    assert not outcome.pays
    assert "is 1.5 times as slow; 0 of 1 problems answered" in outcome.verdict
    assert outcome.as_dict()["strategy_worst_cost_ratio"] is None


def test_costs_near_zero_and_below_are_compared() -> None:
    row = (attempt(1.0, -2.0, True), attempt(1.0, -2.0, True), attempt(0.1, -1.0))
    assert compare(row).summarise("alone").worst_cost_ratio == pytest.approx(1.5)
    row = (attempt(1.0, None), attempt(1.0, None), attempt(0.1, 2.0))
    assert not compare(row).pays  # nothing to compare the cost with
