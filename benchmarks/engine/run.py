"""`engine`: the compiled tree beside others on the published cart-pole.

Runs of a controller, noise on its state after each step. Every problem goes to the tree, some go to
the slow contenders, whose answers must agree. DAQP's own mixed-integer mode shows no bound: none of
its answers counts as proved. Times are CPU seconds of the solve with everything it builds; the
taking of a statement's coefficients, which all need, is apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

import numpy as np

from benchmarks.engine.cuts import run_cuts
from benchmarks.engine.daqp_mode import solve_daqp_mode
from benchmarks.engine.flyers import run_flyers
from benchmarks.engine.products import run_products
from benchmarks.engine.remembering import run_remembering
from benchmarks.engine.ticks import run_ticks
from climbplan.instances.cart_pole import MAX_STATE, PUSHED, build_walled_cart_pole
from climbplan.methods.envelope_rounds import solve_micp
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.leaf_cover import build_horizon_shift
from climbplan.solvers.mixed_integer.method import WarmStartedTree, solve_mixed_integer
from climbplan.solvers.registry import require
from climbplan.solvers.result import SolverResult

_GAP, _TOLERANCE = 1e-3, 1e-6
_STEPS = 50
_RUNS, _QUICK = 100, 2
_NOISE = (0.001, 0.003)  # standard deviation, of the state's bounds
_OTHERS = 8  # problems of a noise that slow contenders get
_LIMIT = 60.0  # [s]

Contender = Callable[[Instance], SolverResult]


@dataclass
class _Column:
    """What one contender did."""

    seconds: list[float] = field(default_factory=list)
    nodes: list[int] = field(default_factory=list)
    proved: int = 0
    worst: float = 0.0  # relative difference of the objective to the tree's

    def add(self, found: SolverResult, seconds: float, objective: float) -> None:
        """One problem."""
        self.seconds.append(seconds)
        self.nodes.append(found.nodes)
        self.proved += found.status == "optimal"
        off = np.inf if found.objective is None else abs(found.objective - objective)
        self.worst = max(self.worst, off / max(abs(objective), 1e-9))


def run_engine(seed: int, quick: bool, stream: TextIO) -> None:
    """Print a table for each noise, then walls, cuts, free-flyers, products."""
    print(
        "noise   engine             problems  proved  median [ms]   99 % [ms]  nodes   99 %  "
        "of the tree   cost off by",
        file=stream,
    )
    for noise in _NOISE:
        columns = _measured(noise, seed, _QUICK if quick else _RUNS, _OTHERS if not quick else 2)
        own = float(np.median(columns["tree, cold"].seconds))
        for name, column in columns.items():
            seconds, nodes = np.array(column.seconds), np.array(column.nodes)
            print(
                f"{noise:5.3f}   {name:<18} {len(seconds):8d}  {column.proved:6d}  "
                f"{1e3 * np.median(seconds):11.2f}  {1e3 * np.quantile(seconds, 0.99):10.2f}  "
                f"{np.median(nodes):5.0f}  {np.quantile(nodes, 0.99):5.0f}  "
                f"{np.median(seconds) / own:11.2f}  {column.worst:11.1e}",
                file=stream,
            )
    run_ticks(seed, quick, stream)
    run_cuts(seed, quick, stream)
    run_flyers(seed, quick, stream)
    run_products(seed, quick, stream)
    run_remembering(seed, quick, stream)


def _measured(noise: float, seed: int, runs: int, others: int) -> dict[str, _Column]:
    problem = build_walled_cart_pole()
    blocks = problem.program.blocks
    state = problem.program.variables["state"]
    slow: dict[str, Contender] = {
        "daqp, own mode": lambda i: solve_daqp_mode(i, state, _GAP),
        "micp (highs)": lambda i: solve_micp(problem, i, None, _GAP, _LIMIT, _TOLERANCE),
        "minlp-scip": lambda i: require("minlp-scip").load()(i, gap=_GAP, time_limit=_LIMIT),
    }
    names = ("tree, cold", "tree, remembering", *slow)
    columns = {name: _Column() for name in names}
    solve_mixed_integer(problem.instance({"start": PUSHED}), _GAP)  # compiles where it has to
    every = max(1, runs * _STEPS // others)
    number = 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        begun, memory = PUSHED, WarmStartedTree(_GAP, _TOLERANCE)
        for step in range(_STEPS):
            instance = problem.instance({"start": begun})
            begin = time.process_time()
            cold = solve_mixed_integer(instance, _GAP, tolerance=_TOLERANCE)
            spent = time.process_time() - begin
            if cold.x is None or cold.objective is None:
                break  # a push that no input makes good: the run is over
            columns["tree, cold"].add(cold, spent, cold.objective)
            begin = time.process_time()
            warm = memory.solve(
                instance, move=(lambda f: build_horizon_shift(blocks, f, 1)) if step else None
            )
            spent = time.process_time() - begin
            columns["tree, remembering"].add(warm, spent, cold.objective)
            if number % every == every // 2:
                for name, solve in slow.items():
                    begin = time.process_time()
                    found = solve(instance)
                    spent = time.process_time() - begin
                    # Of DAQP without building its matrices, which do not change in closed loop
                    taken = found.time if name.startswith("daqp") else spent
                    columns[name].add(found, taken, cold.objective)
            number += 1
            after = problem.values(cold.x)["state"][1]
            begun = after + noise * rng.normal(size=4) * MAX_STATE
    return columns
