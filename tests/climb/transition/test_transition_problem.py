"""Transitions by methods of the common table: their answers go the way of the planner's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.motion.motion import StageClock
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.complementarity_data import build_complementarity_data
from climbplan.climb.transition.homotopy import extract_sequence, is_complementary
from climbplan.climb.transition.motion import plan_motion, read_first_position, read_rounds
from climbplan.climb.transition.motion_data import build_shape
from climbplan.climb.transition.motion_formulation import compile_motion_program, formulate_motion
from climbplan.climb.transition.problem import build_motion_problem, build_transition_problem
from climbplan.climb.transition.round_constraints import COST_SCALE
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.search import SequenceSearch
from climbplan.climb.transition.sequence_planning import (
    TransitionRun,
    compute_cost,
    plan_and_verify_sequence,
    verify_motion,
)
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method

SPECS = Path(__file__).parents[3] / "specs"


def searched(name: str, *overrides: str) -> tuple[TransitionRun, SequenceSearch]:
    loaded = load_transition(SPECS / f"{name}.yaml", ["margins=none", *overrides])
    scene = build_transition(loaded)
    return TransitionRun(loaded, scene, StageClock(lambda stage, fraction: None)), SequenceSearch(
        scene
    )


@pytest.mark.parametrize("method", ["nlp", "mccormick", "admm"])
def test_the_motion_of_a_sequence_by_methods_of_the_table(method: Method) -> None:
    run, search = searched("transition_flat")
    sequence = search.list_sequences()[0]
    problem, theta = build_motion_problem(run, search.tables, sequence)
    result = solve_instance(problem, theta, method).result
    assert result.x is not None, result.log
    stated = formulate_motion(build_shape(run.scene, 2))
    rounds = read_rounds(search.tables, stated, sequence, result.x)
    planned = plan_motion(search.tables, sequence).rounds
    np.testing.assert_allclose(rounds.com, planned.com, atol=1e-4)
    done, verification = verify_motion(
        run, rounds, sequence.moves, read_first_position(stated, result.x)
    )
    assert verification.passed, verification.table()
    assert result.objective is not None
    cost = compute_cost(run.scene, done.rounds, done.forces)
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
    sequence = search.list_sequences()[0]
    problem, theta = build_transition_problem(run, search.tables, sequence)
    assert problem.program.counts()["binary"] == 6 * run.scene.spec.task.rounds
    result = solve_instance(problem, theta, method).result
    assert result.x is not None, result.log
    motion = build_complementarity_data(run.scene)
    assert is_complementary(motion, result.x)
    tables, found = extract_sequence(motion, result.x)
    if method == "pinned":
        np.testing.assert_array_equal(found.moves, sequence.moves)
    attempt = plan_and_verify_sequence(run, tables, found)
    assert attempt.motion is not None, attempt.reason


def test_what_does_not_complement_is_no_sequence() -> None:
    run, search = searched("transition_flat")
    problem, theta = build_transition_problem(run, search.tables, search.list_sequences()[0])
    x = solve_instance(problem, theta, "pinned").result.x
    assert x is not None
    motion = build_complementarity_data(run.scene)
    x[motion.program.formulation.place("hold")[0, 0]] = 0.5
    assert not is_complementary(motion, x)


def test_a_sequence_that_is_not_carried_through_is_refused() -> None:
    run, search = searched("transition_flat")
    problem, theta = build_transition_problem(run, search.tables, search.list_sequences()[0])
    x = solve_instance(problem, theta, "pinned").result.x
    assert x is not None
    stated = build_complementarity_data(run.scene).program.formulation
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
    motion = plan_motion(search.tables, search.list_sequences()[0], 30.0)
    assert not motion.is_accepted
    number, name = motion.block.removeprefix("round ").split(", ")
    assert number in {"1", "2"}
    assert name in compile_motion_program(build_shape(search.scene, 2)).formulation.sizes()
