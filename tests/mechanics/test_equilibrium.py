"""Forces that balance a load, and contacts that cannot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.mechanics.equilibrium import balance_load, grasp_matrix, total_load, wrench_of
from climbplan.robots.model import Robot
from climbplan.schema.robots.robot import RobotSpec


def test_grasp_matrix_sums_forces_and_moments() -> None:
    rng = np.random.default_rng(0)
    arms, force = rng.normal(size=(2, 7, 5, 3))
    by_matrix = np.einsum("bij,bj->bi", grasp_matrix(arms), force.reshape(7, 15))
    np.testing.assert_allclose(by_matrix, wrench_of(arms, force), atol=1e-12)
    moment = sum(np.cross(arms[3, i], force[3, i]) for i in range(5))
    np.testing.assert_allclose(by_matrix[3], [*force[3].sum(axis=0), *moment], atol=1e-12)


@pytest.mark.parametrize("n", [3, 4, 6, 8])
def test_every_member_of_the_family_balances_the_load(n: int) -> None:
    rng = np.random.default_rng(n)
    arms, load = 0.5 * rng.normal(size=(4, n, 3)), 50 * rng.normal(size=(4, 6))
    ((rows, balance),) = balance_load(arms, load, length=0.5)
    assert rows.tolist() == [0, 1, 2, 3]
    assert balance.null_space.shape == (4, 3 * n, 3 * n - 6)
    y = 20 * rng.normal(size=(4, 3 * n - 6))
    force = balance.particular + np.einsum("bij,bj->bi", balance.null_space, y)
    np.testing.assert_allclose(wrench_of(arms, force.reshape(4, n, 3)), -load, atol=1e-10)
    np.testing.assert_allclose(balance.residual, 0, atol=1e-12)


def test_two_contacts_resist_all_but_one_moment() -> None:
    arms = np.array([[[0.6, 0.0, 0.1], [-0.6, 0.0, 0.1]]] * 2)
    below = [0.0, 0.0, -100.0, 0.0, 0.0, 0.0]  # weight in the plane of the contacts
    aside = [0.0, 0.0, -100.0, 10.0, 0.0, 0.0]
    ((_, balance),) = balance_load(arms, np.array([below, aside]), length=0.5)
    assert balance.rank.tolist() == [5, 5]
    assert balance.null_space.shape[-1] == 1
    assert balance.residual[0] < 1e-12
    # The free rotation is about the line through the contacts, 0.1 m above the body.
    assert balance.residual[1] == pytest.approx(10 / np.hypot(0.5, 0.1))


def test_ranks_are_told_apart_within_a_batch() -> None:
    line = [[-0.5, 0.0, 0.0], [0.1, 0.0, 0.0], [0.5, 0.0, 0.0]]
    triangle = [[-0.5, 0.0, 0.0], [0.1, 0.4, 0.0], [0.5, 0.0, 0.0]]
    parts = balance_load(np.array([triangle, line, triangle]), np.ones((3, 6)), length=0.5)
    assert {int(b.rank[0]): rows.tolist() for rows, b in parts} == {5: [1], 6: [0, 2]}


def test_total_load_adds_the_weight(braced_robot: Callable[..., RobotSpec]) -> None:
    robot = Robot.from_spec(braced_robot(4))
    wrench = np.arange(12.0).reshape(2, 6)
    expected = wrench.copy()
    expected[:, 2] -= 9.0 * 9.81
    angles = np.zeros((2, robot.limb_count, robot.joint_count))
    found = total_load(robot, wrench, np.zeros((2, 3)), angles)
    np.testing.assert_allclose(found, expected)
    assert wrench[0, 2] == 2.0  # what is given stays
