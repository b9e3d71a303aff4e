"""What a search needs of each gait: compiled rollouts, costs and stance phases against NumPy."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from walk_tasks import LEGS, named, shorter, stairs_task, walk_task

from climbplan.walking.check.reference_dynamics import integrate_knots
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.dynamics.dynamics import (
    BodyNumbers,
    knot_step,
    single_stage_knot_step,
    sum_contact_wrench,
)
from climbplan.walking.kernels.contact_phases import HELD, SWINGING, find_stance_phases
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.gait_moves import generate_region_moves, list_contact_moves
from climbplan.walking.offline.gaits import is_left_right_symmetric, mirror_gait
from climbplan.walking.task.task import STATE, Integrator

RNG = np.random.default_rng(9)


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_rollout_over_knots_is_that_of_the_checker(integrator: Integrator) -> None:
    task = shorter(walk_task((0.5, 0.2, 0), integrator=integrator), 5)
    state = task.start.state.copy()
    state[6:] = RNG.normal(0, 0.4, 6)
    task = replace(task, start=replace(task.start, state=state))
    toes = task.body.toe_center + RNG.normal(0, 0.05, (6, LEGS, 3))
    force = RNG.normal(0, 15, (5, LEGS, 3))
    mine = FixedContactProgram(task, named("trot", task)).roll_out(toes, force)
    theirs = integrate_knots(task.body, integrator, task.dt, state, toes[:-1], force)
    np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-10)


def test_cost_is_the_objective() -> None:
    task = shorter(walk_task(), 5)
    state, force = RNG.normal(0, 1, (6, STATE)), RNG.normal(0, 15, (6, LEGS, 3))
    mine = FixedContactProgram(task, named("trot", task)).compute_cost(state, force)
    assert mine == pytest.approx(compute_objective(task, state, force), rel=1e-12)


def test_stance_phases() -> None:
    for _ in range(20):
        contact = RNG.random((7, LEGS)) < 0.6
        foothold, phases = find_stance_phases(contact)
        assert (foothold == SWINGING).tolist() == (~contact).tolist()
        assert (foothold[0] == HELD).tolist() == contact[0].tolist()
        for k, (leg, first, last) in enumerate(phases):
            assert contact[first : last + 1, leg].all()
            assert not contact[first - 1, leg]
            assert last == 6 or not contact[last + 1, leg]
            assert (foothold[:, leg] == k).sum() == last - first + 1
        # All other stances begin at the start.
        lands = (contact[1:] & ~contact[:-1]).sum()
        assert len(phases) == lands


def test_plain_step_is_exact_for_euler_and_near_for_mean() -> None:
    body = BodyNumbers.of(walk_task().body)
    names = ca.SX.sym("state", STATE), ca.SX.sym("toes", 12), ca.SX.sym("force", 12)
    point = (
        RNG.normal(0, 0.3, STATE),
        (walk_task().body.toe_center + RNG.normal(0, 0.05, (LEGS, 3))).ravel(),
        RNG.normal(0, 15, 12),
    )
    off, load = [], sum_contact_wrench(names[1], names[2])
    for mean, step in ((0.0, 0.08), (1.0, 0.04), (1.0, 0.02)):
        exact = ca.Function("exact", names, [knot_step(body, step, mean, names[0], *load)])
        plain = ca.Function(
            "plain", names, [single_stage_knot_step(body, step, mean, names[0], *load)]
        )
        off.append(float(ca.norm_inf(exact(*point) - plain(*point))))
    assert off[0] < 1e-12
    assert off[2] < 0.3 * off[1]  # of second order


def test_mirror_images() -> None:
    task = walk_task()
    assert is_left_right_symmetric(task)
    assert not is_left_right_symmetric(walk_task((0.0, 0.2, 0.0)))
    assert not is_left_right_symmetric(stairs_task())
    gait = named("trot", task)
    assert mirror_gait(mirror_gait(gait)).key == gait.key
    assert mirror_gait(gait).key == named("trot", task, 1).key


def test_moves_change_something() -> None:
    gait = named("trot", walk_task())
    moves = list_contact_moves(gait.contact)
    assert all((moved != gait.contact).any() for moved in moves)
    assert all(moved.shape == gait.contact.shape for moved in moves)
    assert not list(generate_region_moves(gait, [np.zeros(0, int)]))
    beside = [np.array(regions) for regions in ([1], [0, 2], [1])]
    others = list(
        generate_region_moves(build_gait(gait.contact, np.ones(gait.contact.shape, int)), beside)
    )
    assert {int(other.region.min()) for other in others} == {0, 1}
    assert {int(other.region.max()) for other in others} == {1, 2}
