"""Trajectories stated piece by piece: layout, named residuals, IPOPT's answer judged by them."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
import pytest

from climbplan.program.trajectory import Trajectory
from climbplan.solvers.ipopt.trajectory import solve_trajectory

QUIET = {"max_iter": 50}


def thrown(goal: float, most: float = 20.0) -> tuple[Trajectory, list[ca.MX]]:
    """A stone thrown so that it is at `goal` [m] after a second, with least speed."""
    stone = Trajectory("stone")
    x = [stone.variable("x", [0.0], -50.0, 50.0) for _ in range(3)]
    v = stone.variable("v", [5.0, 100.0], -most, most)
    stone.equal("start", x[0], "m")
    for k in range(2):
        stone.equal("motion", x[k + 1] - x[k] - 0.5 * v[0], "m")
    stone.between("goal", x[2], goal, goal + 1.0, "m")
    stone.minimise("speed", v[0] ** 2)
    stone.minimise("speed", ca.sumsqr(v[1]))
    return stone, [v, x[2]]


def test_pieces_of_a_name_are_one_block() -> None:
    stone, _ = thrown(3.0)
    assert stone.start.tolist() == [0.0, 0.0, 0.0, 5.0, 20.0]  # brought into its bounds
    assert stone.rows.numel() == 4
    blocks = {block.name: block for block in stone.residuals(np.array([0.0, 0.1, -0.2, 2.0]))}
    assert set(blocks) == {"start", "motion", "goal"}
    assert (blocks["motion"].residual, blocks["motion"].index) == (pytest.approx(0.2), (1,))
    assert blocks["goal"].residual == pytest.approx(1.0)
    assert blocks["goal"].unit == "m"
    unknown = stone.residuals(np.array([np.nan, 0, 0, 3.5]))
    assert unknown[0].residual == np.inf


def test_an_answer_and_what_is_read_from_it() -> None:
    stone, outputs = thrown(3.0)
    answer = solve_trajectory(stone, outputs, QUIET, time.perf_counter())
    assert answer.solved
    assert answer.optimal
    np.testing.assert_allclose(answer.values[0].ravel(), [3.0, 0.0], atol=1e-5)
    assert answer.objective == pytest.approx(9.0, abs=1e-4)
    assert max(block.residual for block in answer.residuals) <= 1e-6


def test_what_cannot_be_names_the_block_that_is_off() -> None:
    stone, outputs = thrown(30.0)
    answer = solve_trajectory(stone, outputs, QUIET, time.perf_counter())
    assert not answer.solved
    assert any(f" of {name}" in answer.message for name in ("goal", "motion", "start"))
