"""What a comparison tells of torques: of robots of any size, and of runs that reach nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.simulation.comparison import PlanComparison
from climbplan.climb.simulation.study import SimulationStudy, format_headline


def comparison(torque: Array, planned: Array) -> PlanComparison:
    """Of K instants and N limbs (K, N), everything but torques as planned."""
    count, limbs = planned.shape
    none, place = np.zeros((count, limbs)), np.zeros((count, 3))
    number = np.arange(count)
    return PlanComparison(
        instant=number, sample=number, torque=torque, torque_planned=planned,
        friction=none, friction_planned=none, mu=none + 1, sag=place, sag_predicted=place,
        lag=place, slips=(), lost_contacts=(),
    )  # fmt: skip


def told(compared: PlanComparison) -> str:
    run = SimpleNamespace(fallen=False, time=np.ones(1), execution=None)
    found: Any = SimpleNamespace(run=run, comparison=compared)
    return format_headline(cast("SimulationStudy", found))


def test_torques_of_a_small_robot_are_compared() -> None:
    """All are under 1 N m; those far under the largest stay out."""
    planned = np.array([[0.5, 0.1], [0.2, 0.4], [0.01, 0.02]])
    small = comparison(planned * [[1.1], [1.1], [5.0]], planned)
    assert small.min_torque == pytest.approx(0.1)
    np.testing.assert_allclose(small.torque_error, [0.1, 0.1])
    assert "torque 10.0% off (median)" in told(small)


def test_torques_of_a_large_robot_are_compared_from_one_newton_metre_on() -> None:
    planned = np.array([[40.0, 3.0], [1.5, 0.5], [0.9, 0.4]])
    large = comparison(planned * 1.2, planned)
    assert large.min_torque == 1.0
    np.testing.assert_allclose(large.torque_error, [0.2, 0.2])


def test_only_a_run_that_reaches_no_instant_says_so() -> None:
    idle = np.zeros((3, 2))
    assert "no torque planned" in told(comparison(idle, idle))
    assert "no instant reached" in told(comparison(idle[:0], idle[:0]))
