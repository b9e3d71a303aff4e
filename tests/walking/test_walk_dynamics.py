"""Dynamics: expressions against plain NumPy, Jacobians by finite differences, continuous time."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from walk_tasks import walk_task

from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.truth import (
    continuous_rollout,
    euler_rates,
    knot_step,
    runge_kutta,
)
from climbplan.walking.dynamics import BodyNumbers
from climbplan.walking.dynamics import knot_step as symbolic_step
from climbplan.walking.kernels.step import linearised
from climbplan.walking.task import ANGLES, LEGS, SPIN, STATE, VELOCITY, Integrator

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
    state, toes, force = some_states(1)[0], some_toes(1)[0], RNG.normal(0, 15, (LEGS, 3))
    names = ca.SX.sym("state", STATE), ca.SX.sym("toes", 12), ca.SX.sym("force", 12)
    mean = float(integrator == "mean")
    step = ca.Function("step", names, [symbolic_step(BodyNumbers.of(BODY), 0.08, mean, *names)])
    after = knot_step(BODY, integrator, 0.08, state, toes, force)
    found = np.asarray(step(state, toes.ravel(), force.ravel())).ravel()
    np.testing.assert_allclose(found, after, atol=1e-11)


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_compiled_steps_and_slopes(integrator: Integrator) -> None:
    """Steps against NumPy, their Jacobians by finite differences."""
    count = 3
    parts = [some_states(count), some_toes(count), RNG.normal(0, 15, (count, LEGS, 3))]
    inverse = np.linalg.inv(BODY.inertia).astype(float)
    after, slopes = np.empty((count, STATE)), np.empty((count, 36, STATE))
    mean = integrator == "mean"
    state, toes, force = parts
    mass, gravity, inertia = BODY.mass, BODY.gravity, BODY.inertia
    linearised(mass, gravity, inertia, inverse, 0.08, mean, state, toes, force, after, slopes)
    np.testing.assert_allclose(
        after, knot_step(BODY, integrator, 0.08, parts[0], parts[1], parts[2]), atol=1e-11
    )
    h, column = 1e-5, 0
    for held in parts:
        for index in np.ndindex(held.shape[1:]):
            ends = []
            for step in (h, -2 * h):
                held[(slice(None), *index)] += step
                ends.append(knot_step(BODY, integrator, 0.08, parts[0], parts[1], parts[2]))
            held[(slice(None), *index)] += h
            slope = (ends[0] - ends[1]) / (2 * h)
            np.testing.assert_allclose(slopes[:, column], slope, atol=2e-6)
            column += 1


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
