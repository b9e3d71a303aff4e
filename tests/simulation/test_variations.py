"""Random worlds are the same for a seed; falls are counted with honest intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.sweep import SweepSettings, sweep
from climbplan.climb.simulation.variations import draw_conditions, run_climb_trial
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.trials import FallRate, run_trials

Planned = Callable[..., ClimbPlan]


def test_worlds_of_a_seed(planned: Planned) -> None:
    plan = planned()
    first = draw_conditions(plan, Conditions(speed=2.0), 4, 7)
    assert first == draw_conditions(plan, Conditions(speed=2.0), 4, 7)
    assert first[:2] == draw_conditions(plan, Conditions(speed=2.0), 2, 7)
    assert len({c.friction for c in first}) == 4
    assert all(0.5 <= c.friction <= 1.05 and c.speed == 2.0 and c.losses for c in first)


def test_share_has_wilson_interval() -> None:
    low, high = FallRate(2, 8).interval
    assert (low, high) == pytest.approx((0.0715, 0.5907), abs=1e-3)
    assert FallRate(0, 8).interval[0] == 0.0
    assert FallRate(0, 8).interval[1] == pytest.approx(0.324, abs=1e-3)


def test_a_slippery_world_fells_a_plan_that_a_grippy_one_carries(planned: Planned) -> None:
    worlds = [Conditions(speed=2.0), Conditions(friction=0.3, speed=2.0)]
    good, bad = run_trials(partial(run_climb_trial, planned()), worlds)
    assert not good.fallen
    assert bad.fallen
    assert bad.time < good.time


def test_sweep_says_where_there_is_no_plan(planned: Planned) -> None:
    asked = SweepSettings(
        "force.safety_friction", (1.5, 40.0), Conditions(speed=4.0), runs=1, seed=1
    )
    points = sweep(planned(), asked)
    assert len(points[0].trials) == 1
    assert points[0].no_plan == ""
    assert points[1].trials == ()
    assert points[1].no_plan


def test_outcomes_do_not_depend_on_workers(planned: Planned) -> None:
    plan = planned()
    worlds = draw_conditions(plan, Conditions(speed=8.0), 2, 5, most_backlash=0.005)
    alone = run_trials(partial(run_climb_trial, plan), worlds)
    assert alone == run_trials(partial(run_climb_trial, plan), worlds, jobs=2)


def test_random_backlash_leaves_the_rest_of_a_world_as_it_is(planned: Planned) -> None:
    plan = planned()
    without = draw_conditions(plan, Conditions(), 3, 7)
    loose = draw_conditions(plan, Conditions(), 3, 7, most_backlash=0.006)
    assert [replace(c, backlash=0.0) for c in loose] == list(without)
    assert len({c.backlash for c in loose}) == 3
    assert all(0 < c.backlash < 0.006 for c in loose)
