"""Splitting estimates small probabilities without bias, and its intervals hold them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import norm

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.risk.estimation import estimate_risk
from climbplan.climb.simulation.risk.multilevel_splitting import (
    build_rare_dict,
    estimate_fall_probability,
    format_rare_event,
    run_multilevel_splitting,
)
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions

Planned = Callable[..., ClimbPlan]


def beyond(limit: float) -> Callable[[Array], Array]:
    """Worlds fall where a standard normal sum of four of their numbers is beyond a limit."""

    def severity(numbers: Array) -> Array:
        found = numbers[:, :4].sum(axis=1) / 2
        return np.where(found > limit, np.inf, found)

    return severity


@pytest.mark.parametrize("limit", [2.33, 3.09, 3.72])
def test_it_finds_probabilities_that_are_known(limit: float) -> None:
    true = float(norm.sf(limit))
    runs = [run_multilevel_splitting(beyond(limit), 60, 3000, seed) for seed in range(30)]
    found = np.array([run.probability for run in runs])
    assert found.mean() == pytest.approx(true, abs=3.5 * found.std(ddof=1) / np.sqrt(30))
    assert found.mean() == pytest.approx(true, rel=0.4)
    held = sum(run.interval[0] <= true <= run.interval[1] for run in runs)
    assert held >= 25
    assert all(1000 < run.worlds <= 3100 for run in runs)  # fewer where chains die out
    if true < 1e-3:  # plain worlds would need as many, and more
        assert np.median([run.equivalent_worlds for run in runs]) > 5 * 3000


def test_falls_that_are_common_are_counted() -> None:
    run = run_multilevel_splitting(beyond(0.0), 10, 1000, 0)
    assert len(run.levels) == 1
    assert run.probability == pytest.approx(0.5, abs=0.06)


def test_where_nothing_falls_the_upper_limit_is_that_of_worlds_that_stood() -> None:
    run = run_multilevel_splitting(lambda numbers: np.zeros(len(numbers)), 10, 1000, 0)
    assert run.probability == 0.0
    assert run.interval == pytest.approx((0.0, 3.69 / run.worlds), rel=0.01)


def test_few_worlds_are_refused() -> None:
    with pytest.raises(UsageError, match="at least 1000 worlds"):
        run_multilevel_splitting(beyond(1.0), 10, 400, 0)


@pytest.mark.slow
def test_a_plans_falls_are_found_as_by_counting(planned: Planned) -> None:
    plan = planned("uncertainty.friction=0.2", "uncertainty.surface_mm=0")
    counted = estimate_risk(plan, Conditions(), "statics", 1000, 1)
    rare = estimate_fall_probability(plan, Conditions(), 1000, 3)
    low, high = rare.interval
    least, most = counted.interval
    assert low <= most
    assert high >= least
    assert build_rare_dict(rare)["probability"] == rare.probability
    assert f"{rare.probability:.2e}" in format_rare_event(rare)[0]


@pytest.mark.slow
def test_it_does_not_depend_on_workers(planned: Planned) -> None:
    plan = planned()
    alone = estimate_fall_probability(plan, Conditions(), 1000, 5)
    both = estimate_fall_probability(plan, Conditions(), 1000, 5, workers=2)
    assert alone.levels == pytest.approx(both.levels, abs=0)
    assert alone.pass_fractions == pytest.approx(both.pass_fractions, abs=0)
