"""The QP with states as unknowns is the QP with states eliminated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from walk_tasks import named, stairs_task, walk_task

from climbplan.walking.check.checker import is_feasible
from climbplan.walking.offline.fixed_contact_qp import FOOT_SCALE, WalkIterate
from climbplan.walking.offline.gaits import assign_regions, repeat_gait
from climbplan.walking.offline.sqp import guess_iterate, interpolate_iterates, solve_gait
from climbplan.walking.offline.staged_qp import MIN_KNOTS, StagedContactProgram
from climbplan.walking.task.task import WalkTask

WHOLE = {"integrator": "mean", "workspace_over_stance": True}
TASKS: dict[str, Callable[[], WalkTask]] = {
    "euler": lambda: walk_task((0.8, 0, 0)),
    "mean": lambda: walk_task((0.8, 0, 0), **WHOLE),
    "goal": lambda: walk_task(
        (0.4, 0, 0), **WHOLE, knots=12, goal={"position": [0.4, 0.05], "within": 0.05}
    ),
    "stairs": stairs_task,
    "long": lambda: walk_task((0.8, 0, 0), **WHOLE, knots=MIN_KNOTS),
}


def _collect_unknowns(program: StagedContactProgram, iterate: WalkIterate) -> np.ndarray:
    """Return the unknowns of the dense QP."""
    force = iterate.force[program.stand_knot, program.stand_leg] / program.force_scale
    return np.concatenate([force.ravel(), (iterate.spots / FOOT_SCALE).ravel()])


def _assign(task: WalkTask, name: str) -> StagedContactProgram:
    contact = repeat_gait(name, task.body.leg_count, task.knots)
    return StagedContactProgram(task, assign_regions(task, contact), margin=1e-3)


@pytest.mark.parametrize("gait", ["trot", "walk", "jump", "walking trot"])
@pytest.mark.parametrize("form", list(TASKS))
def test_both_forms_of_a_qp_have_one_solution(form: str, gait: str) -> None:
    """The answer obeys the rows of the dense QP, predicts its states, and costs no more."""
    task = TASKS[form]()
    program = _assign(task, gait)
    iterate, compared = guess_iterate(task, program.gait), 0
    for _ in range(3):
        staged = program._solve_staged(iterate)
        dense = super(StagedContactProgram, program).solve_qp(iterate)
        if dense is None:
            break
        if staged is None:  # the first QP of a jump has no interior
            iterate = interpolate_iterates(iterate, dense, 0.7)
            continue
        qp, z = program.build_qp(iterate), _collect_unknowns(program, staged)
        count = program.num_unknowns
        values = np.concatenate([z, qp.rows @ z])
        assert (values >= qp.lower - 1e-5).all()
        assert (values <= qp.upper + 1e-5).all()
        np.testing.assert_allclose(staged.state, qp.offset + qp.sensitivity @ z, atol=2e-4)
        costs = [
            0.5 * u @ qp.hessian @ u + qp.gradient @ u
            for u in (z, _collect_unknowns(program, dense))
        ]
        scale = abs(float(qp.gradient[:count] @ z))
        assert costs[0] == pytest.approx(costs[1], abs=1e-5 * scale)
        assert program.compute_cost(staged.state, staged.force) <= (
            program.compute_cost(dense.state, dense.force) * (1.0 + 1e-5) + 1e-6
        )
        iterate, compared = interpolate_iterates(iterate, dense, 0.7), compared + 1
    assert compared or form in ("goal", "stairs")


def test_long_horizons_are_solved_with_states_as_unknowns() -> None:
    task = walk_task((0.8, 0, 0), **WHOLE, knots=MIN_KNOTS)
    assert StagedContactProgram.suits(task)
    assert not StagedContactProgram.suits(walk_task())
    answer = solve_gait(task, named("trot", task), None, 20)
    assert answer.trajectory is not None
    assert answer.is_feasible
    assert is_feasible(task, answer.trajectory)


def test_qps_without_a_solution_are_left_to_the_dense_form() -> None:
    """No gait reaches a goal that is nine metres away."""
    task = walk_task(
        (0, 0, 0), **WHOLE, knots=MIN_KNOTS, goal={"position": [9.0, 0.0], "within": 0.01}
    )
    program = _assign(task, "trot")
    iterate = guess_iterate(task, program.gait)
    assert program._solve_staged(iterate) is None
    assert program.solve_qp(iterate) is None
