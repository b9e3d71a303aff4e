"""Runs of every solver and method that take many seconds, to be stopped inside it.

`python hard_runs.py NAME` starts one of them as a notebook would: no command line above it, nothing
that kills it. Once it is inside its solver it says `running` on standard output, as SCIP turns
standard error away.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from random_scenes import stepping_scene

import climbplan
from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.program import Instance, Program
from climbplan.program.staged_program import StagedProgram

SPECS = Path(__file__).parents[2] / "specs"
_INSIDE = 0.3  # [s] that a run has been inside its solver when it says so
_LOOK = 0.01  # [s]


@dataclass(frozen=True)
class HardRun:
    """What to call, and where its solver is: a function of a file."""

    call: Callable[[], object]
    file: str
    function: str
    prepare: Callable[[], object] = lambda: None  # compiles what is compiled once


def market_split(rows: int = 5, columns: int = 40) -> Instance:
    """Weights to be split in half at once (Cornuejols and Dawande 1998): hard for every tree."""
    weights = np.random.default_rng(0).integers(0, 100, (rows, columns)).astype(float)
    p = Program("market split")
    chosen = p.binary("chosen", (columns,))
    over, under = p.continuous("over", (rows,), 0, 1e4), p.continuous("under", (rows,), 0, 1e4)
    p.equal("half", weights @ chosen + over - under - np.floor(weights.sum(axis=1) / 2))
    p.minimise("off", over.sum() + under.sum())
    return p.instantiate()


def large(size: int, quadratic: bool) -> Instance:
    """Dense rows, and a cost that is linear or of distances: seconds for one convex program."""
    rng = np.random.default_rng(1)
    p = Program("large")
    p.continuous("x", (size,), -10.0, 10.0)
    x = p.affine("x")
    p.between("rows", x @ rng.normal(size=(size, size)), -np.ones(size), np.ones(size))
    p.minimise("distance", (x - rng.normal(size=size) * 5.0).sum_of_squares())
    found = p.instantiate()
    return found if quadratic else replace(found, P=0.0 * found.P)


def stepping() -> Instance:
    """Limbs that step over many patches."""
    return stepping_scene(4, rounds=12, limbs=4, patches=8).instantiate()


def valley(size: int = 3000) -> Instance:
    """Rosenbrock's curved valley in many dimensions: thousands of small steps."""
    p = Program("valley")
    x, y = p.continuous("x", (size,), -5, 5), p.continuous("y", (size,), -30, 30)
    p.equal("square", y - x * x)
    p.minimise("valley", 100 * np.sum((x[1:] - y[:-1]) ** 2) + np.sum((1 - x[:-1]) ** 2))
    return p.instantiate()


def split_valley() -> Instance:
    """The valley with a binary for each step, which complementarity has to make whole."""
    size = 600
    p = Program("split valley")
    x, y = p.continuous("x", (size,), -5, 5), p.continuous("y", (size,), -30, 30)
    up = p.binary("up", (size,))
    p.equal("square", y - x * x)
    p.when("above", up, x, lower=1.0)
    p.when("below", up, x, upper=-1.0, value=False)
    p.minimise("valley", 100 * np.sum((x[1:] - y[:-1]) ** 2) + np.sum((1 - x[:-1]) ** 2))
    return p.instantiate()


def _trajectory() -> object:
    from climbplan.solvers.ipopt.staged_program import solve_staged_program

    walk = StagedProgram("valley", ca.MX)
    x = walk.variable("x", np.tile([-1.2, 1.0], 2000), -5.0, 5.0)
    walk.between("box", x, -4.0, 4.0)
    walk.minimise("valley", 100 * ca.sumsqr(x[1:] - x[:-1] ** 2) + ca.sumsqr(1 - x[:-1]))
    return solve_staged_program(walk, [x], {"max_iter": 100_000}, time.perf_counter())


def _solve(instance: Callable[[], Instance], solver: str) -> Callable[[], object]:
    def call() -> object:
        from climbplan.solvers.registry import solve

        return solve(instance(), solver, gap=1e-6, time_limit=120.0)

    return call


def _convex(solver: Any, size: int) -> Callable[[], object]:
    def call() -> object:
        from climbplan.solvers.convex.sessions import solve_convex

        while True:
            solve_convex(large(size, True), solver)

    return call


def _sqp() -> object:
    sys.path.insert(0, str(SPECS))
    from cart_pole import problem, random_theta

    from climbplan.solvers.sqp.method import SqpSolver

    instance = problem().program.instantiate(random_theta(np.random.default_rng(0)))
    solver, rng = SqpSolver(instance), np.random.default_rng(1)
    while True:
        start = rng.uniform(-1.0, 1.0, instance.size)
        solver.solve(np.zeros(instance.size), np.zeros(0, np.int64), start)


def _shelf() -> object:
    from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
    from climbplan.bookshelf.scene.shelf_scene import Shelf, ShelfScene

    rng = np.random.default_rng(3)
    count = 9
    size = np.column_stack([rng.uniform(0.1, 0.14, count), rng.uniform(0.01, 0.02, count)])
    pose = np.column_stack([np.linspace(-0.1, 0.1, count), size[:, 0] / 2, np.zeros(count)])
    limits = ExactLimits(gap_absolute=0.0, gap_relative=0.0, time=120.0)
    return ExactSolver(Shelf(), limits).solve(ShelfScene(pose, size, np.array([0.12, 0.02])))


def _compile_shelf() -> object:
    from climbplan.bookshelf.exact.method import compile_once

    return compile_once()


def _plan(spec: str, **changes: Any) -> Callable[[], object]:
    """A shipped spec by the public door."""

    def call() -> object:
        keys = {key.replace("__", "."): value for key, value in changes.items()}
        return climbplan.plan(climbplan.load_spec(SPECS / f"{spec}.yaml", overrides=keys))

    return call


def _again(call: Callable[[], object]) -> Callable[[], object]:
    """What is over in seconds, for ever."""

    def loop() -> object:
        while True:
            call()

    return loop


RUNS = {
    "highs-tree": HardRun(_solve(market_split, "highs"), "solvers/highs/model.py", "run_highs"),
    "highs-quadratic": HardRun(
        _solve(lambda: large(1500, True), "highs"), "solvers/highs/model.py", "run_highs"
    ),
    "highs-linear": HardRun(
        _solve(lambda: large(1500, False), "highs"), "solvers/highs/model.py", "run_highs"
    ),
    "scip": HardRun(_solve(stepping, "scip"), "solvers/scip/run.py", "run_model"),
    "tree": HardRun(
        _again(_solve(stepping, "branch-and-bound")),
        "solvers/tree/branch_and_bound.py",
        "solve_branch_and_bound",
    ),
    "bonmin": HardRun(_solve(market_split, "bonmin"), "solvers/bonmin.py", "_run_process"),
    "ipopt": HardRun(_solve(valley, "ipopt"), "solvers/ipopt/program.py", "solve"),
    "mpcc": HardRun(_solve(split_valley, "mpcc"), "solvers/ipopt/program.py", "solve"),
    "trajectory": HardRun(_trajectory, "solvers/ipopt/program.py", "solve"),
    "daqp": HardRun(_convex("daqp", 800), "solvers/convex/daqp.py", "solve"),
    "clarabel": HardRun(_convex("clarabel", 700), "solvers/convex/clarabel.py", "solve"),
    "osqp": HardRun(_convex("osqp", 800), "solvers/convex/osqp.py", "solve"),
    "sqp": HardRun(_sqp, "solvers/sqp/method.py", "solve"),
    "shelf": HardRun(_shelf, "bookshelf/exact/method.py", "_search", _compile_shelf),
    "consensus": HardRun(
        _plan("limms_jump", solver__method="admm"),
        "limms/consensus/planner.py",
        "find_first_integers",
    ),
    "knots": HardRun(
        _plan("limms_jump", solver__method="admm"), "limms/consensus/nonlinear.py", "solve"
    ),
    "legs": HardRun(_plan("limms_jump"), "limms/legs/solver.py", "solve_legs"),
    "arms": HardRun(
        _again(_plan("limms_double_arm")), "solvers/ipopt/staged_program.py", "solve_staged_program"
    ),
    "homotopy": HardRun(
        _plan("transition_flat", solver__method="mpcc"),
        "climb/transition/homotopy.py",
        "run_from_start",
    ),
    "walk-search": HardRun(
        _plan("mpc_turn", solver__method="gait-search"), "offline/search.py", "search"
    ),
    "walk-nlp": HardRun(_plan("mpc_turn", solver__method="mpcc"), "offline/nlp.py", "solve_nlp"),
    "walk-micp": HardRun(
        _plan("mpc_forward", solver__method="spatial-branch-and-bound", task__integrator="euler"),
        "walking/micp/solver.py",
        "solve_micp",
    ),
}


def _announce(run: HardRun) -> None:
    """Say it once the main thread has been in that function for a while."""
    main = threading.main_thread().ident
    assert main is not None
    inside = 0.0
    last = time.monotonic()
    while inside < _INSIDE:
        time.sleep(_LOOK)
        frame = sys._current_frames().get(main)
        now = time.monotonic()
        while frame is not None:
            code = frame.f_code
            if code.co_filename.endswith(run.file) and code.co_name == run.function:
                inside += now - last
                break
            frame = frame.f_back
        last = now
    print("running", flush=True)


if __name__ == "__main__":
    chosen = RUNS[sys.argv[1]]
    chosen.prepare()
    threading.Thread(target=_announce, args=(chosen,), daemon=True).start()
    with ctrl_c_insists():  # as `climbplan.plan` and `climbplan.solve` have it
        chosen.call()
