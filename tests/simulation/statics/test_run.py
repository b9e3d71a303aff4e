"""Quasi-static steps go where MuJoCo goes, and press as planned where nothing is wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.replay import simulate
from climbplan.simulation.statics.playback import played, prepare
from climbplan.simulation.statics.run import FELL

Planned = Callable[..., ClimbPlan]


@pytest.mark.parametrize("regulator", ["nothing", "joints"])
def test_it_goes_where_mujoco_goes(planned: Planned, regulator: str) -> None:
    plan = planned()
    conditions = Conditions(regulator=regulator)
    steps = prepare(plan, conditions)
    n = plan.robot.limb_count
    path = np.zeros((len(steps.sample), 3 + 6 * n))
    row = played(plan, steps, conditions, path)
    run = simulate(plan, conditions)
    assert not row[FELL]
    assert not run.fallen
    off = np.linalg.norm(path[:, :3] - run.com[steps.sample], axis=1)
    assert np.median(off) < 1.5e-3  # MuJoCo's toes sink in by some tenths of that
    assert off.max() < 5e-3
    forces = path[:, 3 + 3 * n :].reshape(-1, n, 3)
    apart = np.linalg.norm(forces - run.force[steps.sample], axis=2)
    assert np.median(apart) < 0.5  # [N]


def test_at_the_start_it_presses_as_planned(planned: Planned) -> None:
    plan = planned()
    steps = prepare(plan, Conditions())
    n = plan.robot.limb_count
    path = np.zeros((len(steps.sample), 3 + 6 * n))
    played(plan, steps, Conditions(), path)
    assert path[0, :3] == pytest.approx(plan.rounds.com[0], abs=1e-4)
    total = path[0, 3 + 3 * n :].reshape(n, 3).sum(axis=0)
    assert total == pytest.approx([0.0, 0.0, plan.robot.weight], abs=0.1)
