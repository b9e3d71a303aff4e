"""Methods: what they answer passes the exact check, and searching is worth its time."""

from __future__ import annotations

import numpy as np
import pytest
from walk_tasks import named, shorter, stairs_task, walk_task

from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.kernels.contact_phases import SWINGING
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram
from climbplan.walking.offline.footing import build_footing, build_gait
from climbplan.walking.offline.gaits import generate_initial_gaits
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.offline.sqp import build_iterate, roll_out, solve_gait
from climbplan.walking.problem.random_tasks import StartRanges, sample_start

RNG = np.random.default_rng(7)


def test_stance_phases() -> None:
    contact = np.array([[1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 1, 1], [1, 1, 1, 1]], bool)
    footing = build_footing(build_gait(contact, np.zeros((4, 4), int)))
    assert footing.count == 3
    assert footing.leg.tolist() == [0, 1, 2]
    assert footing.first.tolist() == [3, 1, 2]
    assert footing.last.tolist() == [3, 3, 3]
    assert footing.foothold[2, 0] == SWINGING


def test_regions_of_swinging_toes_are_where_they_go() -> None:
    contact = np.array([[1, 1, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 1]], bool)
    region = np.zeros((4, 4), int)
    region[2, 0], region[3, 0], region[3, 1] = 1, 5, 7
    tidy = build_gait(contact, region).region
    assert tidy[:, 0].tolist() == [0, 1, 1, 1]
    assert tidy[:, 1].tolist() == [0, 0, 0, 0]


def test_the_qp_predicts_what_the_dynamics_do() -> None:
    """About a motion that obeys the dynamics the linearisation is exact up to second order."""
    task = walk_task((0.8, 0, 0), integrator="mean")
    gait = named("trot", task)
    program = FixedContactProgram(task, gait)
    settled = solve_gait(task, gait, iterations=8).trajectory
    assert settled is not None
    at = build_iterate(settled, gait)
    qp = program.build_qp(at)
    rng = np.random.default_rng(1)
    z = np.zeros(program.num_unknowns)
    force, spots = at.force[program.stand_knot, program.stand_leg], at.spots
    z[: program.foot_column] = (force / program.force_scale).ravel()
    z[program.foot_column :] = spots.ravel() / 0.1
    off = []
    for size in (1e-3, 1e-4):
        moved = z + size * rng.normal(size=len(z))
        there = program.build_iterate(qp, moved)
        off.append(np.abs(roll_out(program, there).state - there.state).max())
    assert off[1] < 0.05 * off[0]


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_search_beats_every_named_gait(integrator: str) -> None:
    task = shorter(walk_task(integrator=integrator), 6)
    named_best = min(
        solve_gait(task, gait, None, 40).objective
        for gait in list(generate_initial_gaits(task))[:6]
    )
    answer = search(task, SearchLimits(60.0, gaits=40, seed=1))
    assert answer.trajectory is not None
    assert format_failures(check_trajectory(task, answer.trajectory)) == ""
    assert answer.objective < named_best
    assert answer.objective == pytest.approx(answer.history[-1].objective)


def test_search_does_not_depend_on_the_clock() -> None:
    task = shorter(walk_task((-1.0, 0, 0), integrator="mean"), 5)
    one, two = (search(task, SearchLimits(1e4, gaits=30, seed=3)) for _ in range(2))
    assert one.objective == two.objective
    assert one.trajectory is not None
    assert two.trajectory is not None
    np.testing.assert_array_equal(one.trajectory.gait.contact, two.trajectory.gait.contact)


def test_least_contacts_are_kept() -> None:
    task = shorter(walk_task(min_contacts=2), 5)
    answer = search(task, SearchLimits(60.0, gaits=40))
    assert answer.trajectory is not None
    assert answer.trajectory.gait.contact[:-1].sum(axis=1).min() >= 2


def test_stairs_are_stood_on() -> None:
    task = stairs_task()
    answer = search(task, SearchLimits(60.0, gaits=25))
    assert answer.trajectory is not None
    assert format_failures(check_trajectory(task, answer.trajectory)) == ""
    gait, toes = answer.trajectory.gait, answer.trajectory.toes
    assert set(gait.region[gait.contact]) == {0, 1}
    assert np.ptp(toes[..., 2][gait.contact]) == pytest.approx(0.03)


def test_nlp_from_random_states() -> None:
    rng, held = np.random.default_rng(2), 0
    for _ in range(6):
        task = walk_task((rng.uniform(-1.0, 1.5), 0, 0), integrator="mean")
        answer = solve_nlp(task, "trot", 20.0)
        if answer.trajectory is not None:
            held += format_failures(check_trajectory(task, answer.trajectory)) == ""
    assert held == 6


def test_nlp_on_stairs() -> None:
    task = stairs_task()
    answer = solve_nlp(task, "trot", 20.0)
    assert answer.trajectory is not None
    assert format_failures(check_trajectory(task, answer.trajectory)) == ""


def test_a_gait_that_cannot_be() -> None:
    """No leg ever stands: the body falls out of the workspace of its toes."""
    task = walk_task()
    nothing = build_gait(np.zeros((10, 4), bool), np.zeros((10, 4), int))
    answer = solve_gait(task, nothing, None, 10)
    assert not answer.is_feasible
    assert answer.reach_violation > 0.1


def test_search_spends_its_budget_and_says_when_time_cut_it_short() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    budget = search(task, SearchLimits(1e4, qps=40))
    assert 40 <= budget.qps <= 60
    assert not budget.cut_short
    late = search(task, SearchLimits(1e-9, qps=40))
    assert late.trajectory is None or "time limit" in late.cut_short
    assert "time limit" in late.cut_short


def test_starts_are_drawn_within_their_ranges() -> None:
    task = walk_task((0.0, 0, 0))
    drawn = [sample_start(task, StartRanges(), np.random.default_rng([3, k])) for k in range(50)]
    velocity = np.array([d.task.start.state[3] for d in drawn])
    at_once = np.array([d.forward + 0.08 * d.acceleration for d in drawn])
    assert np.allclose(velocity, at_once)
    assert np.ptp([d.forward for d in drawn]) > 2.0
    assert np.ptp([d.acceleration for d in drawn]) > 20.0
    assert all(np.array_equal(d.task.start.toes, task.start.toes) for d in drawn)
    wide = sample_start(
        task, StartRanges(lateral=0.5, tilt=0.1, angular_velocity=0.6, toes=0.04), RNG
    ).task
    assert 0 < np.abs(wide.start.toes - task.start.toes).max() <= 0.04
    assert 0 < np.abs(wide.start.state[6:8]).max() <= 0.1
