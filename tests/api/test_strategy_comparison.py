"""What a comparison of a strategy with the default method comes to."""

from __future__ import annotations

import pytest

from climbplan.api.strategy_comparison import ComparedProblem, StrategyComparison


def compared(*rows: tuple[float, float | None, float, float | None]) -> StrategyComparison:
    return StrategyComparison("forest", "auto", tuple(ComparedProblem(*row) for row in rows))


def test_a_strategy_pays_if_it_is_faster_at_the_same_cost() -> None:
    outcome = compared((1.0, 2.0, 0.1, 2.0), (1.0, 3.0, 0.2, 3.001), (1.0, 1.0, 0.2, 1.0))
    assert outcome.speedup == pytest.approx(5.0)
    assert outcome.pays
    assert outcome.verdict.startswith("use forest: 5.0 times as fast; 3 of 3 problems")
    assert outcome.as_dict()["worst_cost_ratio"] == pytest.approx(1.0, abs=1e-3)


def test_a_dearer_answer_does_not_pay() -> None:
    outcome = compared((1.0, 2.0, 0.1, 2.1))
    assert not outcome.pays
    assert outcome.verdict.startswith("use auto: forest is only 10.0 times as fast")


def test_time_without_an_answer_is_lost() -> None:
    outcome = compared((1.0, 2.0, 0.5, None), (1.0, 2.0, 0.5, None))
    assert outcome.problems[0].seconds_with_fallback == pytest.approx(1.5)
    assert not outcome.pays
    assert "1.5 times as slow; 0 of 2 problems" in outcome.verdict
    assert outcome.as_dict()["worst_cost_ratio"] is None


def test_costs_near_zero_and_below_are_compared() -> None:
    assert compared((1.0, -2.0, 0.1, -1.0)).worst_cost_ratio == pytest.approx(1.5)
    assert not compared((1.0, None, 0.1, 2.0)).pays  # nothing to compare the cost with
