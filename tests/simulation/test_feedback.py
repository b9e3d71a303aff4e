"""What the regulator from joint angles does by default, late and with poor sensors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.odometry import standing
from climbplan.simulation.regulator import Regulator
from climbplan.simulation.replay import simulate

Planned = Callable[..., ClimbPlan]


def test_joints_are_the_default() -> None:
    assert NOMINAL.regulator == "joints"


def test_nothing_new_is_corrected_while_a_toe_takes_load(planned: Planned) -> None:
    plan = planned()
    loading = (standing(plan) != plan.trajectory.contact).any(axis=1)
    assert 0.05 < loading.mean() < 0.95
    low = plan.trajectory.com - [0.0, 0.0, 0.01]  # a body that hangs a centimetre low
    for sample, moves in (
        (int(np.flatnonzero(loading)[0]), False),
        (int(np.flatnonzero(~loading)[0]), True),
    ):
        regulator = Regulator(plan, place=True)
        regulator.correction(sample, 0.1, (low[sample], np.eye(3)))
        assert (regulator.shift[2] > 0) == moves


@pytest.mark.parametrize(
    "world",
    [
        {"delay": 0.05},
        {"joint_noise": np.deg2rad(0.05), "noise_seed": 1},
    ],
)
def test_late_and_with_poor_sensors_it_still_carries_a_payload(
    planned: Planned, world: dict[str, float]
) -> None:
    pytest.importorskip("mujoco")
    plan = planned()
    runs = [
        simulate(plan, Conditions(payload=0.5, speed=2.0, **own))  # type: ignore[arg-type]
        for own in ({"regulator": "nothing"}, {}, world)
    ]
    blind, exact, poor = (np.abs(run.com[-1] - plan.trajectory.com[-1]).max() for run in runs)
    assert not any(run.fallen for run in runs)
    assert exact < blind
    assert poor < blind
    # And it is not the same run
    assert not np.array_equal(runs[1].com, runs[2].com)
