"""Random worlds are the same for a seed; falls are counted with honest intervals."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.variations import Share, drawn_conditions, run_trials, sweep

Planned = Callable[..., ClimbPlan]


def test_worlds_of_a_seed(planned: Planned) -> None:
    plan = planned()
    first = drawn_conditions(plan, Conditions(speed=2.0), 4, 7)
    assert first == drawn_conditions(plan, Conditions(speed=2.0), 4, 7)
    assert first[:2] == drawn_conditions(plan, Conditions(speed=2.0), 2, 7)
    assert len({c.friction for c in first}) == 4
    assert all(0.5 <= c.friction <= 1.05 and c.speed == 2.0 and c.losses for c in first)


def test_share_has_wilson_interval() -> None:
    low, high = Share(2, 8).interval
    assert (low, high) == pytest.approx((0.0715, 0.5907), abs=1e-3)
    assert Share(0, 8).interval[0] == 0.0
    assert Share(0, 8).interval[1] == pytest.approx(0.324, abs=1e-3)


def test_a_slippery_world_fells_a_plan_that_a_grippy_one_carries(planned: Planned) -> None:
    good, bad = run_trials(planned(), [Conditions(speed=2.0), Conditions(friction=0.3, speed=2.0)])
    assert not good.fallen
    assert bad.fallen
    assert bad.time < good.time


def test_sweep_says_where_there_is_no_plan(planned: Planned) -> None:
    points = sweep(
        planned(), "force.safety_friction", [1.5, 40.0], Conditions(speed=4.0), 1, seed=1
    )
    assert len(points[0].trials) == 1
    assert points[0].no_plan == ""
    assert points[1].trials == ()
    assert points[1].no_plan
