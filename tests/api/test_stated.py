"""What a spec asks for, as a problem that every method of the table takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import climbplan
from climbplan.errors import UsageError

SPECS = Path(__file__).parents[2] / "specs"
WALK = {"task.knots": 5, "task.integrator": "mean", "task.workspace_over_stance": True}


@pytest.mark.parametrize("method", ["pinned", "mpcc"])
def test_a_walk_by_methods_of_the_table(method: str) -> None:
    problem, theta = climbplan.problem_from_spec(SPECS / "mpc_forward.yaml", overrides=WALK)
    found = climbplan.solve(problem, theta, method=method, time_limit=60)
    assert found.status == "feasible"
    report = found.check()
    names = {block.name for block in report.blocks}
    # The statement's blocks, and those of the checker of walks under the same names
    assert {"dynamics", "force.friction", "workspace.over_stance"} <= names
    assert {"own.dynamics.attitude", "own.force.friction", "own.workspace.over_stance"} <= names
    assert report.passed(1e-6)


def test_an_answer_that_the_problems_own_checker_refuses_is_none() -> None:
    problem, theta = climbplan.problem_from_spec(SPECS / "mpc_forward.yaml", overrides=WALK)
    strict = replace(problem, check=lambda theta, values: {"never": float(len(values))})
    found = climbplan.solve(strict, theta, method="pinned")
    assert found.status == "limit"
    assert "answer refused by the problem's own check: never" in found.message
    assert found.message in repr(found)
    with pytest.raises(UsageError, match=r"there is no solution: limit .*answer refused"):
        found.check()


def test_a_climbs_postures_with_a_row_of_ones_own() -> None:
    problem, theta = climbplan.problem_from_spec(SPECS / "climb_steps.yaml")
    free = climbplan.solve(problem, theta, method="mpcc", time_limit=60)
    aside = float(free["com"][0, 0])
    com = problem.program.affine("com")
    problem.program.between("mine.aside", com[0, :1], aside + 0.005, np.inf, unit="m")
    held = climbplan.solve(problem, theta, method="mpcc", time_limit=60)
    assert held["com"][0, 0] >= aside + 0.005 - 1e-6
    assert held.check()["mine.aside"].residual < 1e-6
    with pytest.raises(KeyError, match=r"no block 'mine'.*mine.aside"):
        held.check()["mine"]
    with pytest.raises(KeyError, match="states no 'comm', its variables are toe, com, rpy"):
        problem.program.affine("comm")


def test_a_climb_with_exact_rotations_up_a_tube() -> None:
    problem, theta = climbplan.problem_from_spec(
        SPECS / "climb_tube.yaml", overrides={"task.rounds": 9}
    )
    free = climbplan.solve(problem, theta, method="nlp")
    names = {block.name for block in free.check().blocks}
    assert {"body.clearance", "own.body.clearance", "own.kinematics.forward"} <= names
    assert free.check().passed(1e-6)
    lowest = float(free["com4"][2]) + 0.01
    com = problem.program.affine("com4")
    problem.program.between("mine.higher", com[2:], lowest, np.inf, unit="m")
    held = climbplan.solve(problem, theta, method="nlp")
    assert held["com4"][2] == pytest.approx(lowest, abs=1e-6)
    assert held.objective > free.objective

    # The exact check is asked, too
    def bent(theta: object, values: dict[str, np.ndarray]) -> dict[str, float]:
        assert problem.check is not None
        return dict(problem.check(theta, {**values, "rpy9": values["rpy9"] + 0.05}))

    refused = climbplan.solve(replace(problem, check=bent), theta, method="nlp")
    assert "steps.rotation by" in refused.method_result.result.log[-1]


@pytest.mark.parametrize(
    ("spec", "method"),
    [("transition_flat", "pinned"), ("transition_flat", "mpcc"), ("transition_bricks", "nlp")],
)
def test_a_transition_by_methods_of_the_table(spec: str, method: str) -> None:
    # Of this method a named sequence, of the others any
    named = {"task.sequence": "LF LR RM | RF RR LM | LF LR RM"} if method == "nlp" else {}
    problem, theta = climbplan.problem_from_spec(
        climbplan.load_spec(SPECS / f"{spec}.yaml", overrides=named)
    )
    found = climbplan.solve(problem, theta, method=method, time_limit=60)
    assert found.status == "feasible"
    report = found.check()
    names = {block.name for block in report.blocks}
    assert {"transition.reach", "force.equilibrium", "steps.com"} <= names
    # A named sequence is fixed: all checks of its plan; others are carried through
    assert ("own.force.friction" if method == "nlp" else "own.carried_through") in names
    assert report.passed(1e-6)


@pytest.mark.parametrize("method", ["pinned", "mpcc"])
def test_a_shelf_by_methods_of_the_table(method: str) -> None:
    problem, theta = climbplan.problem_from_spec(SPECS / "bookshelf_scene.yaml")
    found = climbplan.solve(problem, theta, method=method, time_limit=60)
    assert found.status in ("optimal", "feasible")
    assert any(block.name.startswith("own.") for block in found.check().blocks)


def test_what_states_no_problem_is_named() -> None:
    with pytest.raises(UsageError, match=r"climb.*; this is of kind limms"):
        climbplan.problem_from_spec(SPECS / "limms_throw.yaml")
    with pytest.raises(UsageError, match="expected one scene, got"):
        climbplan.problem_from_spec(SPECS / "bookshelf_file.yaml")
