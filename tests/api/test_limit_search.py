"""Which values a search for a limit tries, on thresholds that are known."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from climbplan.api.limit_search import (
    Bound,
    Domain,
    Proposals,
    Tolerance,
    guess_direction,
    propose_between_ends,
    propose_values,
)

FREE = Bound(1e9, is_closed=False)
POSITIVE = Bound(0.0, is_closed=False)
FIVE_PERCENT = Tolerance(0.05, is_relative=True)


def outcomes_of(proposals: Proposals, passes: Callable[[float], bool]) -> dict[float, bool]:
    """Return the outcomes of a search by value, in the order in which values were tried."""
    outcomes: dict[float, bool] = {}
    value = next(proposals)
    while True:
        assert value not in outcomes
        outcomes[value] = passes(value)
        try:
            value = proposals.send(outcomes[value])
        except StopIteration:
            return outcomes


def bracket(outcomes: dict[float, bool]) -> tuple[float, float]:
    """Return the largest value that passes and the smallest that fails."""
    return max(v for v, p in outcomes.items() if p), min(v for v, p in outcomes.items() if not p)


@pytest.mark.parametrize("threshold", [0.013, 0.7, 1.0, 1.37, 36.5])
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_the_largest_value_is_bracketed(threshold: float, start: float) -> None:
    domain = Domain(start, Bound(0.0), FREE, 0.5)
    outcomes = outcomes_of(
        propose_values(domain, "largest", FIVE_PERCENT), lambda value: value <= threshold
    )
    assert next(iter(outcomes)) == start
    low, high = bracket(outcomes)
    assert low <= threshold < high
    assert high - low <= 0.05 * max(high, domain.scale) * 1.001
    assert len(outcomes) <= 20


@pytest.mark.parametrize("threshold", [0.013, 0.37, 0.8, 3.0])
def test_the_smallest_value_is_bracketed(threshold: float) -> None:
    domain = Domain(0.8, POSITIVE, FREE, 0.1)
    outcomes = outcomes_of(
        propose_values(domain, "smallest", FIVE_PERCENT), lambda value: value >= threshold
    )
    assert min(outcomes) > 0
    passed = min(value for value, passes in outcomes.items() if passes)
    failed = max(value for value, passes in outcomes.items() if not passes)
    assert failed < threshold <= passed
    assert passed - failed <= 0.05 * max(passed, domain.scale) * 1.001


def test_values_are_doubled_and_halved() -> None:
    domain = Domain(1.0, Bound(0.0), Bound(10.0), 0.5)
    everything = outcomes_of(propose_values(domain, "largest", FIVE_PERCENT), lambda value: True)
    assert list(everything) == [1, 2, 4, 8, 10]
    nothing = outcomes_of(propose_values(domain, "largest", FIVE_PERCENT), lambda value: False)
    assert list(nothing)[:3] == [1, 0.5, 0.25]
    assert list(nothing)[-1] == 0
    assert list(Domain(0.0, Bound(0.0), FREE, 0.5).walk(1, 4)) == [0.5, 1, 2, 4]
    # Towards zero and beyond, where the range goes on there
    assert list(Domain(20.0, Bound(-50.0), FREE, 2.0).walk(-1, 5)) == [0, -2, -4, -8, -16, -50]
    # An open end is approached
    assert list(Domain(0.5, POSITIVE, Bound(0.9, is_closed=False), 1.0).walk(1, 3)) == [
        pytest.approx(0.7), pytest.approx(0.8), pytest.approx(0.85)
    ]  # fmt: skip


def test_counts_stay_whole() -> None:
    domain = Domain(3.0, Bound(1.0), Bound(200.0), 1.0, is_integer=True)
    outcomes = outcomes_of(
        propose_values(domain, "largest", Tolerance(0.01, is_relative=True)), lambda v: v <= 17
    )
    assert bracket(outcomes) == (17, 18)
    assert all(value == int(value) for value in outcomes)


@pytest.mark.parametrize(
    ("passes", "direction", "limits"),
    [
        (lambda value: value <= 3, "largest", (3.0, 3.2)),
        (lambda value: value >= 3, "smallest", (2.8, 3.2)),
        (lambda value: 1 < value < 3, "largest", (2.8, 3.2)),
    ],
)
def test_both_ends_show_the_direction(
    passes: Callable[[float], bool], direction: str, limits: tuple[float, float]
) -> None:
    domain = Domain(2.0, Bound(1.0), Bound(9.0), 0.5)
    outcomes = outcomes_of(propose_between_ends(domain, Tolerance(0.1, False)), passes)
    assert list(outcomes)[:3] == [2, 1, 9]
    assert guess_direction(outcomes) == direction
    last = list(outcomes)[-1]
    assert limits[0] <= last <= limits[1]
