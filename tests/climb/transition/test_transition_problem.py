"""Transitions by methods of the common table: their answers go the way of the planner's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.motion.motion import StageClock
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.carrying import Run, carry_through, transition_cost, verified
from climbplan.climb.transition.complementarity_numbers import free_motion
from climbplan.climb.transition.homotopy import complements, sequence_at
from climbplan.climb.transition.motion import first_at, plan_motion, rounds_at
from climbplan.climb.transition.motion_numbers import shape_of
from climbplan.climb.transition.motion_statement import motion_program, motion_statement
from climbplan.climb.transition.problem import motion_problem, transition_problem
from climbplan.climb.transition.round_rows import COST_SCALE
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.search import Search
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method

SPECS = Path(__file__).parents[3] / "specs"


def searched(name: str, *overrides: str) -> tuple[Run, Search]:
    loaded = load_transition(SPECS / f"{name}.yaml", ["margins=none", *overrides])
    scene = build_transition(loaded)
    return Run(loaded, scene, StageClock(lambda stage, fraction: None)), Search(scene)


@pytest.mark.parametrize("method", ["nlp", "micp", "admm"])
def test_the_motion_of_a_sequence_by_methods_of_the_table(method: Method) -> None:
    run, search = searched("transition_flat")
    sequence = search.sequences()[0]
    problem, theta = motion_problem(run, search.lab, sequence)
    result = solve_instance(problem, theta, method).result
    assert result.x is not None, result.log
    stated = motion_statement(shape_of(run.scene, 2))
    rounds = rounds_at(search.lab, stated, sequence, result.x)
    planned = plan_motion(search.lab, sequence).rounds
    np.testing.assert_allclose(rounds.com, planned.com, atol=1e-4)
    done, verification = verified(run, rounds, sequence.moved, first_at(stated, result.x))
    assert verification.passed, verification.table()
    assert result.objective is not None
    cost = transition_cost(run.scene, done.rounds, done.forces)
    assert result.objective / COST_SCALE == pytest.approx(cost, rel=5e-3)
    # The checker of plans has judged the answer by itself
    own = {block.name: block.residual for block in problem.own_residuals(theta, result.x)}
    assert {f"own.{check.name}" for check in verification.checks} == set(own)
    assert max(own.values()) == 0.0
    off = result.x.copy()
    off[stated.place("pose")[1, 2]] += 0.3
    assert max(block.residual for block in problem.own_residuals(theta, off)) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "method"),
    [
        ("transition_flat", "pinned"),
        ("transition_flat", "mpcc"),
        ("transition_flat", "admm"),
        ("transition_bricks", "pinned"),
        ("transition_bricks", "mpcc"),
    ],
)
def test_sequences_by_methods_of_the_table_are_carried_through(scene: str, method: Method) -> None:
    run, search = searched(scene, "task.sequence=null")
    sequence = search.sequences()[0]
    problem, theta = transition_problem(run, search.lab, sequence)
    assert problem.program.counts()["binary"] == 6 * run.scene.spec.task.rounds
    result = solve_instance(problem, theta, method).result
    assert result.x is not None, result.log
    motion = free_motion(run.scene)
    assert complements(motion, result.x)
    lab, found = sequence_at(motion, result.x)
    if method == "pinned":
        np.testing.assert_array_equal(found.moved, sequence.moved)
    attempt = carry_through(run, lab, found)
    assert attempt.complete is not None, attempt.reason


def test_what_does_not_complement_is_no_sequence() -> None:
    run, search = searched("transition_flat")
    problem, theta = transition_problem(run, search.lab, search.sequences()[0])
    x = solve_instance(problem, theta, "pinned").result.x
    assert x is not None
    motion = free_motion(run.scene)
    x[motion.program.stated.place("hold")[0, 0]] = 0.5
    assert not complements(motion, x)


def test_a_sequence_that_is_not_carried_through_is_refused() -> None:
    run, search = searched("transition_flat")
    problem, theta = transition_problem(run, search.lab, search.sequences()[0])
    x = solve_instance(problem, theta, "pinned").result.x
    assert x is not None
    stated = free_motion(run.scene).program.stated
    limb = run.scene.robot.limb_names.index("RM")
    path = x[stated.place("toe")]
    early = x.copy()
    # RM, which holds in round 1, goes with the others: two limbs are left on one side
    early[stated.place("hold")[0, limb]] = 0.0
    path[0, 3 * limb : 3 * limb + 3] = path[1, 3 * limb : 3 * limb + 3]
    early[stated.place("toe")] = path
    (refused,) = problem.own_residuals(theta, early)
    assert (refused.name, refused.residual) == ("own.moving limbs", 1.0)


def test_a_motion_that_cannot_be_names_its_round_and_block() -> None:
    _, search = searched("transition_flat")
    motion = plan_motion(search.lab, search.sequences()[0], 30.0)
    assert not motion.accepted
    number, name = motion.block.removeprefix("round ").split(", ")
    assert number in {"1", "2"}
    assert name in motion_program(shape_of(search.scene, 2)).stated.sizes()
