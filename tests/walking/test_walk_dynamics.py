"""Dynamics: expressions against plain NumPy, Jacobians by finite differences, continuous time."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import FrameType

import casadi as ca
import numpy as np
import pytest
from walk_tasks import LEGS, walk_task

from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.reference_dynamics import (
    derivative,
    euler_rates,
    integrate_continuously,
    integrate_knot,
    integrate_knots,
    runge_kutta,
)
from climbplan.walking.dynamics.dynamics import BodyNumbers, sum_contact_wrench
from climbplan.walking.dynamics.dynamics import knot_step as symbolic_step
from climbplan.walking.dynamics.dynamics import state_derivative as symbolic_rates
from climbplan.walking.kernels import compiling, dynamics_step
from climbplan.walking.kernels.discrete_rollout import roll_out_knots
from climbplan.walking.kernels.dynamics_step import linearise_steps
from climbplan.walking.kernels.parameters import ForcedMotion
from climbplan.walking.task.task import ANGLES, SPIN, STATE, VELOCITY, Integrator

RNG = np.random.default_rng(5)
# Products of inertia, which the shipped body has none of
BODY = replace(
    walk_task().body,
    inertia=np.array([[0.098, 0.01, -0.02], [0.01, 0.146, 0.015], [-0.02, 0.015, 0.218]]),
)
NAMES = ca.SX.sym("state", STATE), ca.SX.sym("toes", 12), ca.SX.sym("force", 12)


def some_states(count: int) -> np.ndarray:
    state = RNG.normal(0, 0.4, (count, STATE))
    state[:, 2] += 0.2
    return state


def some_toes(count: int, legs: int = LEGS) -> np.ndarray:
    place = np.resize(BODY.toe_center, (legs, 3))
    return place + RNG.normal(0, 0.05, (count, legs, 3))


def some_forces(count: int, legs: int = LEGS) -> np.ndarray:
    return RNG.normal(0, 15, (count, legs, 3))


def compiled_slopes(
    integrator: Integrator, state: np.ndarray, toes: np.ndarray, force: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps (N, 12) and slopes (N, 12 + 6 L, 12) by the compiled function."""
    after, slopes = (
        np.empty((len(force), STATE)),
        np.full((len(force), 12 + 6 * force.shape[1], STATE), np.nan),
    )
    steps, motion = np.full(len(force), 0.08), ForcedMotion(state, toes, force)
    linearise_steps(BODY.parameters, steps, integrator == "mean", motion, after, slopes)
    return after, slopes


def test_rates_agree_with_numpy() -> None:
    state, toes, force = some_states(1)[0], some_toes(1)[0], some_forces(1)[0]
    rates = ca.Function(
        "rates",
        NAMES,
        [symbolic_rates(BodyNumbers.of(BODY), NAMES[0], *sum_contact_wrench(*NAMES[1:]))],
    )
    found = np.asarray(rates(state, toes.ravel(), force.ravel())).ravel()
    np.testing.assert_allclose(found, derivative(BODY, state, toes, force), atol=1e-10)


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_expressions_agree_with_numpy(integrator: Integrator) -> None:
    state, toes, force = some_states(1)[0], some_toes(1)[0], some_forces(1)[0]
    mean = float(integrator == "mean")
    stated = symbolic_step(
        BodyNumbers.of(BODY), 0.08, mean, NAMES[0], *sum_contact_wrench(*NAMES[1:])
    )
    declared = ca.Function("step", NAMES, [stated])
    after = integrate_knot(BODY, integrator, 0.08, state, toes, force)
    found = np.asarray(declared(state, toes.ravel(), force.ravel())).ravel()
    np.testing.assert_allclose(found, after, atol=1e-10)


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_compiled_steps_and_slopes_are_those_of_the_declaration(integrator: Integrator) -> None:
    count = 20
    state, toes, force = some_states(count), some_toes(count), some_forces(count)
    mean = float(integrator == "mean")
    stated = symbolic_step(
        BodyNumbers.of(BODY), 0.08, mean, NAMES[0], *sum_contact_wrench(*NAMES[1:])
    )
    slopes = ca.jacobian(stated, ca.vertcat(*NAMES))
    declared = ca.Function("declared", NAMES, [stated, slopes])
    after, found = compiled_slopes(integrator, state, toes, force)
    for n in range(count):
        values = declared(state[n], toes[n].ravel(), force[n].ravel())
        np.testing.assert_allclose(after[n], np.array(values[0]).ravel(), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found[n].T, np.array(values[1]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("legs", [4, 6])
@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_compiled_steps_and_slopes(integrator: Integrator, legs: int) -> None:
    """Steps against NumPy, their Jacobians by finite differences."""
    parts = [some_states(3), some_toes(3, legs), some_forces(3, legs)]
    after, slopes = compiled_slopes(integrator, parts[0], parts[1], parts[2])
    np.testing.assert_allclose(
        after, integrate_knot(BODY, integrator, 0.08, parts[0], parts[1], parts[2]), atol=1e-10
    )
    h, column = 1e-5, 0
    for held in parts:
        for index in np.ndindex(held.shape[1:]):
            ends = []
            for move in (h, -2 * h):
                held[(slice(None), *index)] += move
                ends.append(integrate_knot(BODY, integrator, 0.08, parts[0], parts[1], parts[2]))
            held[(slice(None), *index)] += h
            slope = (ends[0] - ends[1]) / (2 * h)
            np.testing.assert_allclose(slopes[:, column], slope, atol=2e-6)
            column += 1


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_compiled_knots_are_those_of_the_checker(integrator: Integrator) -> None:
    start, toes, force = 0.2 * some_states(1)[0], some_toes(6), 0.2 * some_forces(5)
    steps = np.full(len(force), 0.08)
    found = roll_out_knots(BODY.parameters, steps, integrator == "mean", start, toes, force)
    wanted = integrate_knots(BODY, integrator, 0.08, start, toes, force)
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-8)


def test_arrays_need_not_be_c_ordered() -> None:
    state, toes, force = some_states(3), some_toes(3), some_forces(3)
    wanted = compiled_slopes("mean", state, toes, force)
    wide = np.zeros((3, 2 * LEGS, 3))
    wide[:, ::2] = force
    found = compiled_slopes("mean", np.asfortranarray(state), toes, wide[:, ::2])
    for mine, theirs in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_code_is_renewed_after_edits_of_all_that_declares_it() -> None:
    """Whatever file of ours runs while a step is stated is one that the cache is named after."""
    ran: set[Path] = set()

    def watch(frame: FrameType, event: str, argument: object) -> None:
        ran.add(Path(frame.f_code.co_filename))

    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        dynamics_step._step(1.0, True)
        dynamics_step._rates()
    finally:
        sys.setprofile(before)
    room = Path(str(dynamics_step.__file__)).parent
    package = room.parents[1]
    ours = {path for path in ran if path.is_relative_to(package) and path.parent != room}
    assert ours == {Path(str(module.__file__)) for module in compiling.DECLARED}


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
    body = walk_task().body
    state = np.zeros(STATE)
    state[2], state[3] = 0.2, 1.8
    toes = np.tile(body.toe_center, (1, 1, 1))
    toes[..., 0] += 0.072
    toes[..., 2] = 0
    force = np.zeros((1, LEGS, 3))
    force[0, [0, 3], 2] = body.mass * body.gravity / 2
    smooth = integrate_continuously(body, 0.08, state, toes, force)[1]
    off = {
        name: np.abs(integrate_knot(body, name, 0.08, state, toes[0], force[0]) - smooth)[6:].max()
        for name in ("mean", "euler")
    }
    assert off["mean"] < 2e-3
    assert off["euler"] > 100 * off["mean"]
