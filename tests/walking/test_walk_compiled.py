"""Compiled functions of the loop and of the pinned QP against NumPy and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walk_tasks import LEGS, named, shorter, walk_task

from climbplan.walking.check.reference_dynamics import (
    integrate_continuously,
    transform_toes_to_body,
)
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.kernels.contact_phases import shift_horizon
from climbplan.walking.kernels.continuous_rollout import roll_out_horizon
from climbplan.walking.kernels.parameters import GaitHorizon
from climbplan.walking.kernels.toe_workspace import (
    compute_reach_violation,
    compute_stance_violation,
)
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.footing import build_footing
from climbplan.walking.offline.sqp import guess_iterate, roll_out
from climbplan.walking.task.task import STATE, Gait, WalkTask

RNG = np.random.default_rng(8)
TASK = shorter(walk_task(integrator="mean", workspace_over_stance=True), 5)


def trot_point(task: WalkTask = TASK) -> tuple[FixedContactProgram, WalkIterate]:
    gait = named("walking trot", task)
    at = guess_iterate(task, gait)
    off = RNG.normal(0, 0.03, at.state.shape)
    off[0] = 0
    return FixedContactProgram(task, gait), WalkIterate(at.state + off, at.force, at.spots)


def test_rollout_is_that_of_the_checker() -> None:
    start = RNG.normal(0, 0.3, STATE)
    toes = TASK.body.toe_center + RNG.normal(0, 0.05, (6, LEGS, 3))
    force = RNG.normal(0, 15, (5, LEGS, 3))
    body = TASK.body
    steps = np.full(5, 0.08)
    mine, _ = roll_out_horizon(
        body.parameters, GaitHorizon(steps, False, np.ones((6, LEGS), bool), start, False),
        body.toe_workspace, 16, toes, force,
    )  # fmt: skip
    theirs = integrate_continuously(body, 0.08, start, toes[:-1], force, 16)
    np.testing.assert_allclose(mine, theirs, atol=1e-10)


@pytest.mark.parametrize("whole", [False, True])
def test_reach_is_that_of_numpy(whole: bool) -> None:
    program, at = trot_point()
    toes = program.compute_toes(at.state, at.spots)
    body, contact = TASK.body, program.gait.contact
    beyond = (np.abs(transform_toes_to_body(at.state, toes) - body.toe_center) - body.toe_half).max(
        axis=-1
    )
    beyond[0, ~contact[0]] = -np.inf
    worst = beyond.max()
    if whole:
        late = (
            np.abs(transform_toes_to_body(at.state[1:], toes[:-1]) - body.toe_center)
            - body.toe_half
        )
        worst = max(worst, late.max(axis=-1)[contact[:-1]].max())
    mine = compute_reach_violation(body.toe_workspace, whole, contact, at.state, toes)
    assert mine == pytest.approx(worst, abs=1e-12)
    standing = compute_stance_violation(body.toe_workspace, at.state[3], toes[3], contact[3])
    assert standing == pytest.approx(max(beyond[3][contact[3]].max(), 0.0), abs=1e-12)


def test_objective_of_the_qp_is_the_cost_of_its_states() -> None:
    program, at = trot_point()
    qp = program.build_qp(at)
    ridge = 1e-7 * np.abs(qp.hessian.diagonal())
    hessian = qp.hessian - np.diag(1e-7 + ridge)
    values, costs = [], []
    for z in RNG.normal(0, 1, (4, program.num_unknowns)):
        found = program.build_iterate(qp, z)
        values.append(0.5 * z @ hessian @ z + qp.gradient @ z)
        costs.append(
            compute_objective(TASK, found.state, np.concatenate([found.force, found.force[:1]]))
        )
    np.testing.assert_allclose(np.diff(values), np.diff(costs), rtol=1e-5)


def test_states_and_stance_rows_are_slopes() -> None:
    """A small move of the unknowns moves the rollout and the toes in the body as the QP says."""
    program, at = trot_point()
    here = roll_out(program, at)
    at = WalkIterate(here.state, at.force, at.spots)
    qp = program.build_qp(at)
    unit = program.force_scale
    z0 = np.concatenate(
        [(at.force[program.stand_knot, program.stand_leg] / unit).ravel(), (at.spots * 10).ravel()]
    )
    np.testing.assert_allclose(program.build_iterate(qp, z0).state, here.state, atol=1e-9)
    rows = qp.rows[program.num_forces * 8 :][:3].copy()  # a toe that stands at knot 1
    sensitivity = qp.sensitivity.copy()
    leg = int(np.flatnonzero(program.gait.contact[1])[0])
    for k in (0, 4, program.foot_column - 1, program.foot_column, program.num_unknowns - 1):
        ends = []
        for step in (-1e-5, 1e-5):
            z = z0.copy()
            z[k] += step
            force, spots = program.split_solution(z)
            walk = roll_out(program, WalkIterate(at.state, force, spots))
            toe = np.zeros((LEGS, 3))
            toe[leg] = walk.toes[1, leg]
            ends.append((walk.state, transform_toes_to_body(walk.state[1], toe)[leg]))
        slope = (ends[1][0] - ends[0][0]) / 2e-5
        np.testing.assert_allclose(sensitivity[:, :, k], slope, atol=2e-4)
        np.testing.assert_allclose(rows[:, k], (ends[1][1] - ends[0][1]) / 2e-5, atol=2e-4)


def test_what_is_left_of_a_plan_goes_on_in_its_rhythm() -> None:
    """One knot later, with a knot more: legs as in the last interval, the body as fast."""
    gait = named("walking trot", TASK, 1)
    state, toes = RNG.normal(0, 1, (6, STATE)), RNG.normal(0, 1, (6, LEGS, 3))
    force = RNG.normal(0, 1, (6, LEGS, 3))
    step = state[-1, :3] - state[-2, :3]
    contact, states, forces, spots = shift_horizon(gait.contact, state, force, toes)
    np.testing.assert_array_equal(contact, gait.contact[[1, 2, 3, 4, 5, 4]])
    np.testing.assert_array_equal(states[:-1], state[1:])
    np.testing.assert_allclose(states[-1, :3], state[-1, :3] + step)
    np.testing.assert_array_equal(states[-1, 3:], state[-1, 3:])
    np.testing.assert_array_equal(forces, force[[1, 2, 3, 4, 3]])
    footing = build_footing(Gait(contact, np.zeros(contact.shape, np.int64)))
    later = np.concatenate([toes[1:], toes[-1:] + step])
    assert footing.count > 1
    assert footing.first.max() == 5  # one is in the knot that is new
    np.testing.assert_allclose(spots, later[footing.first, footing.leg, :2])


def test_a_program_serves_again_from_another_start() -> None:
    program, at = trot_point()
    moved = TASK.start.state.copy()
    moved[3] += 0.3
    other = replace(TASK, start=replace(TASK.start, state=moved))
    fresh = FixedContactProgram(other, program.gait).solve_qp(at)
    program.solve_qp(at)
    program.restart(other)
    again = program.solve_qp(at)
    assert fresh is not None
    assert again is not None
    np.testing.assert_allclose(again.state, fresh.state, atol=1e-6)


def test_iterations_are_counted_and_limited() -> None:
    program, at = trot_point()
    assert program.solve_qp(at) is not None
    needed = program.num_iterations
    assert needed > 3
    fresh = FixedContactProgram(TASK, Gait(program.gait.contact, program.gait.region))
    assert fresh.solve_qp(at, max_iterations=needed // 2) is None
    assert fresh.num_iterations <= needed // 2 + 1
