"""Quasi-static steps go where MuJoCo goes, and press as planned where nothing is wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.climb.shipped import planned_scene
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.implicit_dynamics.engine import prepare_steps, simulate_steps
from climbplan.climb.simulation.implicit_dynamics.outcome import HAS_FALLEN
from climbplan.climb.simulation.replay import simulate
from climbplan.simulation.conditions import Conditions

Planned = Callable[..., ClimbPlan]


@pytest.mark.slow
@pytest.mark.parametrize("regulator", ["nothing", "joints"])
def test_it_goes_where_mujoco_goes(planned: Planned, regulator: str) -> None:
    _goes_as_mujoco(planned(), regulator, 1.5e-3)  # its toes sink in by some tenths of that


@pytest.mark.slow
@pytest.mark.parametrize("regulator", ["nothing", "joints"])
def test_legs_of_four_joints_go_where_they_go_in_mujoco(regulator: str) -> None:
    plan = planned_scene("climb_walker", []).plan
    assert plan.robot.joint_count == 4
    _goes_as_mujoco(plan, regulator, 2e-3)


def _goes_as_mujoco(plan: ClimbPlan, regulator: str, most: float) -> None:
    """Neither falls, the body is `most` [m] apart (median), forces are the same."""
    conditions = Conditions(regulator=regulator)
    steps = prepare_steps(plan, conditions)
    n = plan.robot.limb_count
    path = np.zeros((len(steps.sample), 3 + 6 * n))
    row = simulate_steps(plan, steps, conditions, path)
    run = simulate(plan, conditions)
    assert not row[HAS_FALLEN]
    assert not run.fallen
    off = np.linalg.norm(path[:, :3] - run.com[steps.sample], axis=1)
    assert np.median(off) < most
    assert off.max() < 5e-3
    forces = path[:, 3 + 3 * n :].reshape(-1, n, 3)
    apart = np.linalg.norm(forces - run.force[steps.sample], axis=2)
    assert np.median(apart) < 0.5  # [N]


def test_at_the_start_it_presses_as_planned(planned: Planned) -> None:
    plan = planned()
    steps = prepare_steps(plan, Conditions())
    n = plan.robot.limb_count
    path = np.zeros((len(steps.sample), 3 + 6 * n))
    simulate_steps(plan, steps, Conditions(), path)
    assert path[0, :3] == pytest.approx(plan.rounds.com[0], abs=1e-4)
    total = path[0, 3 + 3 * n :].reshape(n, 3).sum(axis=0)
    assert total == pytest.approx([0.0, 0.0, plan.robot.weight], abs=0.1)


def test_a_late_regulator_goes_where_a_late_one_goes_in_mujoco(planned: Planned) -> None:
    plan = planned()
    at: dict[float, np.ndarray] = {}
    for delay in (0.0, 0.3):
        conditions = Conditions(delay=delay, payload=0.5)
        steps = prepare_steps(plan, conditions)
        path = np.zeros((len(steps.sample), 3 + 6 * plan.robot.limb_count))
        assert not simulate_steps(plan, steps, conditions, path)[HAS_FALLEN]
        off = path[:, :3] - simulate(plan, conditions).com[steps.sample]
        assert np.median(np.linalg.norm(off, axis=1)) < 1.5e-3
        times = plan.trajectory.time
        at[delay] = np.array([np.interp(times, times[steps.sample], path[:, a]) for a in range(3)])
    assert np.abs(at[0.3] - at[0.0]).max() > 2e-4  # the payload is corrected later


def test_poor_sensors_scatter_the_body_as_in_mujoco(planned: Planned) -> None:
    plan = planned()
    steps = prepare_steps(plan, Conditions())
    end = plan.trajectory.time[-1]
    quasi, full = [], []
    for seed in range(4):
        conditions = Conditions(joint_noise=np.radians(0.1), noise_seed=seed)
        path = np.zeros((len(steps.sample), 3 + 6 * plan.robot.limb_count))
        simulate_steps(plan, steps, conditions, path)
        again = path.copy()
        simulate_steps(plan, steps, conditions, again)
        np.testing.assert_array_equal(again, path)
        run = simulate(plan, conditions)
        assert run.time[-1] == end
        planned_com = plan.trajectory.com[steps.sample]
        quasi.append(path[:, :3] - planned_com)
        full.append(run.com[steps.sample] - planned_com)
    ours, theirs = (np.std(np.array(x), axis=0).mean() for x in (quasi, full))
    assert ours > 1e-4  # [m]: differ from seed to seed
    assert 0.5 < ours / theirs < 2.0
