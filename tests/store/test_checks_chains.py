"""Chains built anew: the same poses by another way, and joints that settle with least energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import _solve_newton, build_chains, solve_chain_equilibrium
from climbplan.robots.serial_chain import SerialChain

SPRING = np.array([[80.0, 60.0, 50.0, 40.0, 30.0, 30.0]])


@pytest.fixture(scope="module", name="chain")
def _chain() -> SerialChain:
    """Six joints about axes of any direction, and a limb with one joint less."""
    rng = np.random.default_rng(5)
    axes = rng.normal(size=(2, 6, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    axes[1, 0] = 0.0
    joints = np.cumsum(rng.uniform(-0.05, 0.15, (2, 6, 3)), axis=1)
    names = (tuple("abcdef"), ("", *"bcdef"))
    toe = joints[:, -1] + [0.1, 0.05, -0.2]
    return SerialChain(names, joints, axes, toe, np.zeros((2, 6)))


def test_the_same_limbs_by_another_way(chain: SerialChain) -> None:
    angles = np.random.default_rng(0).uniform(-2, 2, (30, 2, 6))
    anew, there = build_chains(chain, angles), chain.pose(angles)
    np.testing.assert_allclose(anew.joints, there.joints, atol=1e-14)
    np.testing.assert_allclose(anew.axes, there.axes, atol=1e-14)
    np.testing.assert_allclose(anew.toe, there.toe, atol=1e-14)
    np.testing.assert_allclose(anew.jacobian(), there.jacobian, atol=1e-14)
    force = np.random.default_rng(1).normal(size=(30, 2, 3))
    expected = np.einsum("knijl,kni->knjl", there.hessian, force)
    np.testing.assert_allclose(anew.compute_force_hessian(force), expected, atol=1e-14)


def one(chain: SerialChain) -> SerialChain:
    return chain.only(slice(0, 1))


def energy(angles: Array, command: Array) -> float:
    return float((SPRING[0] * (angles - command) ** 2).sum() / 2)


def test_joints_settle_where_energy_is_least(chain: SerialChain) -> None:
    limb = one(chain)
    rng = np.random.default_rng(3)
    for _ in range(5):
        alike = rng.uniform(-0.8, 0.8, (1, 6))
        command = alike + rng.uniform(-0.05, 0.05, (1, 6))
        toe = limb.pose(alike).toe + rng.uniform(-5e-3, 5e-3, (1, 3))
        settled = solve_chain_equilibrium(limb, toe, alike, command, SPRING)
        assert settled.missing.max() < 1e-12
        found = minimize(
            energy,
            alike[0],
            args=(command[0],),
            method="SLSQP",
            constraints={
                "type": "eq",
                "fun": lambda q, toe=toe: limb.pose(q[None]).toe[0] - toe[0],
            },
            options={"ftol": 1e-14, "maxiter": 300},
        )
        assert found.success
        assert energy(settled.angles[0], command[0]) <= found.fun + 1e-9
        np.testing.assert_allclose(settled.angles[0], found.x, atol=1e-5)


def test_commands_that_press_settle_in_the_planned_angles(chain: SerialChain) -> None:
    """q - k^-1 J^T f is answered by q and f exactly, however large the force."""
    limb = one(chain)
    planned = np.random.default_rng(4).uniform(-0.8, 0.8, (1, 6))
    pose = limb.pose(planned)
    force = np.array([20.0, -15.0, 30.0])
    command = planned - (pose.jacobian[0].T @ force) / SPRING
    settled = solve_chain_equilibrium(limb, pose.toe, planned + 1e-3, command, SPRING)
    np.testing.assert_allclose(settled.angles, planned, atol=1e-10)


def test_limbs_far_from_the_planned_angles_are_found_from_their_commands(
    chain: SerialChain,
) -> None:
    """Newton's method leads nowhere from some of these angles; the body has moved on from them."""
    rng = np.random.default_rng(6)
    there = rng.uniform(-0.5, 0.5, (60, 1, 6))
    planned = there + rng.uniform(-1.3, 1.3, there.shape)
    limb = one(chain)
    toes = limb.pose(there).toe
    first, rests = _solve_newton(limb, toes, planned, there, SPRING, None)
    lost = ~rests | (first.missing > 1e-7)
    assert 3 < lost.sum() < 50
    found = solve_chain_equilibrium(limb, toes, planned, there, SPRING)
    np.testing.assert_allclose(found.angles[lost], there[lost], atol=1e-9)
    np.testing.assert_array_equal(found.angles[~lost], first.angles[~lost])
    assert found.missing.max() < 1e-9


def test_limbs_whose_feet_roll_are_found_from_their_commands_too(chain: SerialChain) -> None:
    """A foot that rolls ends its chain elsewhere in each row, and only some rows are lost."""
    rng = np.random.default_rng(6)
    there = rng.uniform(-0.5, 0.5, (60, 1, 6))
    planned = there + rng.uniform(-1.3, 1.3, there.shape)
    limb = one(chain)
    ends = limb.toe_zero + rng.uniform(-0.02, 0.02, (60, 1, 3))
    rolls = replace(limb, toe_zero=ends)
    toes = build_chains(rolls, there).toe
    arm = rng.uniform(-0.01, 0.01, toes.shape)
    _, rests = _solve_newton(rolls, toes, planned, there, SPRING, arm)
    assert 3 < (~rests).sum() < 50
    found = solve_chain_equilibrium(rolls, toes, planned, there, SPRING, arm)
    assert found.missing.max() < 1e-9
    np.testing.assert_allclose(found.angles[~rests], there[~rests], atol=1e-9)


def test_toes_out_of_reach_are_missed(chain: SerialChain) -> None:
    limb = one(chain)
    alike = np.full((1, 6), 0.3)
    far = limb.joint_zero[:, 0] + [3.0, 0.0, 0.0]
    assert solve_chain_equilibrium(limb, far, alike, alike, SPRING).missing[0] > 1.0
