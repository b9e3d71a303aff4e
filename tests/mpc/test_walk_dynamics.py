"""Dynamics: expressions against plain NumPy, Jacobians by finite differences, continuous time."""

from __future__ import annotations

import numpy as np
import pytest
from walk_tasks import walk_task

from climbplan.mpc.dynamics import BodyNumbers, KnotModel
from climbplan.mpc.task import ANGLES, LEGS, SPIN, STATE, VELOCITY, Integrator
from climbplan.mpc.truth import (
    continuous_rollout,
    euler_rates,
    knot_step,
    runge_kutta,
)
from climbplan.robots.rotations import rotation_world_body

RNG = np.random.default_rng(5)
BODY = walk_task().body


def some_states(count: int) -> np.ndarray:
    state = RNG.normal(0, 0.4, (count, STATE))
    state[:, 2] += 0.2
    return state


def some_toes(count: int) -> np.ndarray:
    return BODY.toe_center + RNG.normal(0, 0.05, (count, LEGS, 3))


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_expressions_agree_with_numpy(integrator: Integrator) -> None:
    model = KnotModel(BodyNumbers.of(BODY), 5)
    model.state[:], model.toes[:] = some_states(5), some_toes(5)
    model.force[:] = RNG.normal(0, 15, (5, LEGS, 3))
    model.dt[:], model.mean[:] = 0.08, float(integrator == "mean")
    model.linearise_step()
    after = knot_step(BODY, integrator, 0.08, model.state, model.toes, model.force)
    np.testing.assert_allclose(model.after, after, atol=1e-11)


@pytest.mark.parametrize("mean", [0.0, 1.0])
def test_jacobians_by_finite_differences(mean: float) -> None:
    model = KnotModel(BodyNumbers.of(BODY), 2)
    model.state[:], model.toes[:] = some_states(2), some_toes(2)
    model.force[:] = RNG.normal(0, 15, (2, LEGS, 3))
    model.dt[:], model.mean[:] = 0.08, mean
    model.linearise_step()
    jacobians = (model.by_state.copy(), model.by_toes.copy(), model.by_force.copy())
    h = 1e-5
    for held, jacobian in zip((model.state, model.toes, model.force), jacobians, strict=True):
        for index in np.ndindex(held.shape[1:]):
            held[(slice(None), *index)] += h
            model.linearise_step()
            up = model.after.copy()
            held[(slice(None), *index)] -= 2 * h
            model.linearise_step()
            down = model.after.copy()
            held[(slice(None), *index)] += h
            slope = (up - down) / (2 * h)
            np.testing.assert_allclose(jacobian[(..., *index)], slope, atol=2e-6)


def test_euler_rates_turn_the_body() -> None:
    state = some_states(4)
    h = 1e-6
    moved = state[:, ANGLES] + h * euler_rates(state[:, ANGLES], state[:, SPIN])
    R, later = (rotation_world_body(a) for a in (state[:, ANGLES], moved))
    found = (later - R) / h @ np.swapaxes(R, -1, -2)  # the skew matrix of the angular velocity
    np.testing.assert_allclose(found[:, 2, 1], state[:, SPIN][:, 0], atol=1e-5)
    np.testing.assert_allclose(found[:, 1, 0], state[:, SPIN][:, 2], atol=1e-5)


def test_free_flight_and_torque_free_rotation() -> None:
    state = some_states(1)[0]
    still = np.zeros((LEGS, 3))
    for _ in range(100):
        state = runge_kutta(BODY, 1e-3, state, still, still)
    first = some_states(1)[0]
    later = first.copy()
    for _ in range(100):
        later = runge_kutta(BODY, 1e-3, later, still, still)
    np.testing.assert_allclose(later[VELOCITY] - first[VELOCITY], [0, 0, -0.981], atol=1e-12)
    fall = first[:3] + 0.1 * first[VELOCITY] - [0, 0, 0.5 * 9.81 * 0.01]
    np.testing.assert_allclose(later[:3], fall, atol=1e-12)
    momenta = []
    for s in (first, later):
        R = rotation_world_body(s[ANGLES])
        momenta.append(R @ BODY.inertia @ R.T @ s[SPIN])
    np.testing.assert_allclose(momenta[0], momenta[1], atol=1e-9)


def test_mean_steps_agree_with_continuous_time_and_euler_does_not() -> None:
    """A trot at 1.8 m/s: the body moves 14 cm above each foothold."""
    state = np.zeros(STATE)
    state[2], state[3] = 0.2, 1.8
    toes = np.tile(BODY.toe_center, (1, 1, 1))
    toes[..., 0] += 0.072
    toes[..., 2] = 0
    force = np.zeros((1, LEGS, 3))
    force[0, [0, 3], 2] = BODY.mass * BODY.gravity / 2
    smooth = continuous_rollout(BODY, 0.08, state, toes, force)[1]
    off = {
        name: np.abs(knot_step(BODY, name, 0.08, state, toes[0], force[0]) - smooth)[6:].max()
        for name in ("mean", "euler")
    }
    assert off["mean"] < 2e-3
    assert off["euler"] > 100 * off["mean"]
