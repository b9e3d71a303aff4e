"""Trajectories stated piece by piece: layout, named residuals, IPOPT's answer judged by them."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
import pytest

from climbplan.methods.table import solve_instance
from climbplan.program.problem import Problem
from climbplan.program.stage import Stage
from climbplan.program.staged_program import StagedProgram
from climbplan.solvers.ipopt.staged_program import compile_staged_program, solve_staged_program

QUIET = {"max_iter": 50}


def thrown(goal: float, most: float = 20.0) -> tuple[StagedProgram, list[ca.MX]]:
    """A stone thrown so that it is at `goal` [m] after a second, with least speed."""
    stone = StagedProgram("stone")
    x = [stone.variable("x", [0.0], -50.0, 50.0) for _ in range(3)]
    v = stone.variable("v", [5.0, 100.0], -most, most)
    stone.equal("start", x[0], "m")
    for k in range(2):
        stone.equal("motion", x[k + 1] - x[k] - 0.5 * v[0], "m")
    stone.between("goal", x[2], goal, goal + 1.0, "m")
    stone.minimise("speed", v[0] ** 2)
    stone.minimise("speed", ca.sumsqr(v[1]))
    return stone, [v, x[2]]


def test_pieces_of_a_name_are_one_block() -> None:
    stone, _ = thrown(3.0)
    assert stone.start.tolist() == [0.0, 0.0, 0.0, 5.0, 20.0]  # brought into its bounds
    assert stone.rows.numel() == 4
    blocks = {block.name: block for block in stone.residuals(np.array([0.0, 0.1, -0.2, 2.0]))}
    assert set(blocks) == {"start", "motion", "goal"}
    assert (blocks["motion"].residual, blocks["motion"].index) == (pytest.approx(0.2), (1,))
    assert blocks["goal"].residual == pytest.approx(1.0)
    assert blocks["goal"].unit == "m"
    unknown = stone.residuals(np.array([np.nan, 0, 0, 3.5]))
    assert unknown[0].residual == np.inf


def test_an_answer_and_what_is_read_from_it() -> None:
    stone, outputs = thrown(3.0)
    answer = solve_staged_program(stone, outputs, QUIET, time.perf_counter())
    assert answer.solved
    assert answer.optimal
    np.testing.assert_allclose(answer.values[0].ravel(), [3.0, 0.0], atol=1e-5)
    assert answer.objective == pytest.approx(9.0, abs=1e-4)
    assert max(block.residual for block in answer.residuals) <= 1e-6


def test_what_cannot_be_names_the_block_that_is_off() -> None:
    stone, outputs = thrown(30.0)
    answer = solve_staged_program(stone, outputs, QUIET, time.perf_counter())
    assert not answer.solved
    assert any(f" of {name}" in answer.message for name in ("goal", "motion", "start"))


def swung(knots: int) -> StagedProgram:
    """A pendulum brought up from a parameter with a push of 0 or 3 a knot; a stage a step."""
    state, after, push = ca.SX.sym("state", 2), ca.SX.sym("after", 2), ca.SX.sym("push")
    step = Stage("step", {"state": state, "after": after, "push": push})
    speed = state[1] + 0.2 * (3 * push - ca.sin(state[0]))
    step.equal("dynamics", after - ca.vertcat(state[0] + 0.2 * speed, speed), "rad")
    step.between("slow", after[1], upper=4.0, unit="rad/s")
    step.minimise("effort", push**2)
    swing = StagedProgram("swing")
    start = swing.parameter("start", 2)
    x = [start, *(swing.variable("x", np.zeros(2), -9.0, 9.0) for _ in range(knots))]
    u = swing.binary("u", np.ones(knots))
    swing.add(step, ca.horzcat(*x[:-1]), ca.horzcat(*x[1:]), u.T)
    swing.between("goal", x[-1][0], 0.7, unit="rad")
    return swing


def test_a_stage_is_called_at_every_knot() -> None:
    swing = swung(4)
    assert swing.sizes() == {"dynamics": 8, "slow": 4, "goal": 1}
    low, high = swing.row_bounds
    assert high.tolist() == [0.0, 0.0, 4.0] * 4 + [np.inf]
    rows = np.array([0, 0, 0, 0, 0.5, 4.5, 0, 0, 0, 0, 0, 0, 0.9])
    blocks = {block.name: block for block in swing.residuals(rows)}
    assert (blocks["dynamics"].residual, blocks["dynamics"].index) == (0.5, (3,))
    assert (blocks["slow"].residual, blocks["slow"].index) == (0.5, (1,))
    other = swing.residuals(rows, (low, np.where(high == 4.0, 5.0, high)))
    assert {b.name: b.residual for b in other}["slow"] == 0.0


def test_every_method_takes_a_trajectory() -> None:
    swing = swung(4)
    program = swing.program()
    assert program.counts()["by_block"] == {"dynamics": 8, "slow": 4, "goal": 1}
    assert program.counts()["smooth_rows"] == 6  # but for the first step, whose sine is a number
    problem = Problem("swing", program, start=lambda theta: swing.guess())
    assert swing.guess()["u"].tolist() == [1, 1, 1, 1]
    assert repr(program) == (
        "<Program 'swing': variables x, x.1, x.2, x.3, u; blocks dynamics, slow, goal>"
    )
    theta = {"start": np.zeros((2, 1))}
    pinned = solve_instance(problem, theta, "pinned").result
    free = solve_instance(problem, theta, "mpcc").result
    assert pinned.x is not None
    assert pinned.objective == pytest.approx(4.0)
    assert free.objective is not None
    assert free.objective <= 3.0 + 1e-6  # not all pushes are needed
    # The same program by IPOPT as it stands, its binaries relaxed
    swing.relax(1e-4)
    ready = compile_staged_program(swing, QUIET)
    point = ready.solver.solve(pinned.x, swing.theta(theta), ready.bounds, np.inf)
    assert max(block.residual for block in ready.residuals(point)) < 1e-6
    assert point.objective <= pinned.objective + 1e-6


def test_numbers_of_parameters_and_bounds_given_later() -> None:
    line = StagedProgram("line")
    slope, level = line.parameter("slope", 2, 2), line.parameter("level", 1)
    x = line.variable("x", [0.0, 0.0])
    line.equal("line", slope @ x - level)
    numbers = line.theta({"level": 7.0, "slope": [[1.0, 2.0], [3.0, 4.0]]})
    assert numbers.tolist() == [1.0, 3.0, 2.0, 4.0, 7.0]  # in order of statement, by columns
    rows = ca.Function("rows", [line.x, line.p], [line.rows])
    assert np.array(rows([1.0, 1.0], numbers)).ravel().tolist() == [-4.0, 0.0]
    with pytest.raises(KeyError):
        line.theta({"slope": np.eye(2)})

    y = line.variable("y", [0.0])
    line.minimise("size", ca.sumsqr(x) + y**2)
    lower = np.array([-1.0, -2.0, 3.0])
    program = line.program(bounds=(lower, np.full(3, 5.0)))
    assert program.variables["x"].lower.tolist() == [-1.0, -2.0]
    assert program.variables["y"].lower.tolist() == [3.0]
    assert program.variables["y"].upper.tolist() == [5.0]


def test_variables_are_found_by_name() -> None:
    walk = StagedProgram("walk")
    for _ in range(3):
        walk.variable("toe", [0.0, 0.0])
        walk.variable("side", np.zeros(0))
        walk.variable("t", [1.0])
    assert walk.place("toe").tolist() == [[0, 1], [3, 4], [6, 7]]
    assert walk.place("side").shape == (3, 0)
    x = walk.point({"toe": [[1, 2], [3, 4], [5, 6]], "t": 9.0, "side": 0.0})
    assert x.tolist() == [1, 2, 9, 3, 4, 9, 5, 6, 9]
    with pytest.raises(KeyError, match="t"):
        walk.point({"toe": 0.0, "side": 0.0})
    with pytest.raises(KeyError, match="heel"):
        walk.place("heel")
    walk.parameter("goal", 2)
    with pytest.raises(ValueError, match="stated twice"):
        walk.parameter("goal", 2)


def test_bounds_of_blocks_are_given_by_name() -> None:
    swing = swung(3)
    assert swing.block("dynamics").tolist() == [[0, 1], [3, 4], [6, 7]]
    lower, upper = swing.replace_row_bounds(
        {"slow": (-1.0, [[2.0], [3.0], [4.0]])}, {"dynamics": [[True, False]], "goal": [False]}
    )
    assert upper.tolist() == [0, np.inf, 2, 0, np.inf, 3, 0, np.inf, 4, np.inf]
    assert lower.tolist() == [0, -np.inf, -1] * 3 + [-np.inf]
    with pytest.raises(KeyError, match="swift"):
        swing.replace_row_bounds({}, {"swift": True})
    # The stated ones are as they were
    assert swing.row_bounds[1].tolist() == [0, 0, 4] * 3 + [np.inf]


def test_inputs_of_a_stage_by_name() -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b")
    stage = Stage("sum", {"a": a, "b": b})
    stage.equal("sum", ca.sum1(a) - b)
    both = StagedProgram("both")
    x, y = both.variable("x", [1.0, 2.0]), both.variable("y", [3.0])
    both.add(stage, x, b=y)
    both.add(stage, b=y, a=x)
    assert both.block("sum").tolist() == [[0], [1]]
    for wrong in ({}, {"b": y, "other": x}):
        with pytest.raises(ValueError, match="sum takes a, b"):
            both.add(stage, x, **wrong)
    with pytest.raises(ValueError, match="sum takes a, b"):
        both.add(stage, x, y, y)


def build_two_stages(knots: int) -> StagedProgram:
    """Knots that follow one another, the first from a parameter; a stage of the last one alone."""
    names = ("before", "after", "target")
    before, after, target = (ca.SX.sym(name, 2) for name in names)
    motion = Stage("motion", {"before": before, "after": after, "target": target})
    motion.equal("dynamics", after - before + ca.sin(before) * after[0])
    motion.between("bound", ca.sumsqr(after), upper=4.0)
    motion.minimise("effort", ca.sumsqr(after - before) * ca.exp(before[1]))
    motion.minimise("tracking", ca.sumsqr(after - target))
    goal = Stage("goal", {"last": after, "again": before})
    goal.equal("goal", after[0] * after[1] * before[0])
    program = StagedProgram("stages")
    x = [program.variable("x", np.zeros(2)) for _ in range(knots)]
    first = program.parameter("first", 2)
    target_values = program.parameter("target", 2, knots)
    program.add(motion, ca.horzcat(first, *x[:-1]), ca.horzcat(*x), target_values)
    program.add(goal, x[-1], again=x[-1])
    return program


@pytest.mark.parametrize("knots", [1, 3])
def test_derivatives_by_stage_are_those_of_the_whole_program(knots: int) -> None:
    program = build_two_stages(knots)
    derivatives = program.build_derivatives()
    expanded = ca.Function("all", [program.x, program.p], [program.cost, program.rows]).expand()
    x, p = ca.SX.sym("x", 2 * knots), ca.SX.sym("p", 2 + 2 * knots)
    cost, rows = expanded(x, p)
    sigma, multipliers = ca.SX.sym("sigma"), ca.SX.sym("lambda", rows.numel())
    hessian = ca.triu(ca.hessian(sigma * cost + ca.dot(multipliers, rows), x)[0])
    expected = ca.Function(
        "expected",
        [x, p, sigma, multipliers],
        [cost, ca.gradient(cost, x), rows, ca.jacobian(rows, x), hessian],
    )
    rng = np.random.default_rng(knots)
    point = [rng.normal(size=size) for size in (2 * knots, 2 + 2 * knots, 1, rows.numel())]
    found = (
        *derivatives.gradient(*point[:2]),
        *derivatives.jacobian(*point[:2]),
        derivatives.hessian(*point),
    )
    for value, reference in zip(found, expected(*point), strict=True):
        np.testing.assert_allclose(np.array(value), np.array(reference), rtol=1e-12, atol=1e-12)


def test_derivatives_by_stage_take_stages_and_selections_only() -> None:
    program = build_two_stages(2)
    program.minimise("more", ca.sumsqr(program.x))
    with pytest.raises(ValueError, match="not all rows and costs are those of stages"):
        program.build_derivatives()
    scaled, symbol = StagedProgram("scaled"), ca.SX.sym("a", 2)
    stage = Stage("stage", {"a": symbol})
    stage.equal("row", symbol)
    scaled.add(stage, 2.0 * scaled.variable("x", np.zeros(2)))
    with pytest.raises(ValueError, match="no selection of variables"):
        scaled.build_derivatives()
