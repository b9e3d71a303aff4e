"""`engine`: Benders cuts beside the tree, between walls that move.

The tree controls the plant of `moving_walls`; every tick goes to the tree and to Benders, with what
each remembers and without. CPU milliseconds of a solve with all that is built.
"""

from __future__ import annotations

import time
from typing import TextIO

import numpy as np

from benchmarks.engine.moving_walls import Plant, moving_walls
from climbplan.methods.sequence import ProblemSequence
from climbplan.methods.table import MethodResult, solve_instance
from climbplan.methods.task import Method, MethodSettings

HORIZONS = (10, 20)  # steps
TICKS, QUICK_TICKS = 100, 10
METHODS: tuple[Method, ...] = ("branch-and-bound", "benders")
_SETTINGS = MethodSettings(gap=1e-3, time_limit=10.0)
_REST = 1e-3  # cost of next to no motion, from which on differences are relative to it


def run_cuts(seed: int, quick: bool, stream: TextIO) -> None:
    """Print a row for each horizon, method and what it begins with."""
    ticks = QUICK_TICKS if quick else TICKS
    print(
        "\nmoving walls, each tick solved to 1e-3 by the tree and by Benders cuts\n"
        "steps  engine            begins with  ticks  proved  median [ms]   99 % [ms]  "
        "nodes or sets   99 %  of the tree  cost off by",
        file=stream,
    )
    for horizon in HORIZONS:
        rows = _measured(horizon, seed, ticks)
        own = float(np.median(rows[METHODS[0], "nothing"][0]))
        for (method, begun), (seconds, found, off) in rows.items():
            proved = sum(f.result.status in ("optimal", "infeasible") for f in found)
            nodes, here = [f.result.nodes for f in found], 1e3 * np.array(seconds)
            print(
                f"{horizon:5d}  {method:<16}  {begun:<11}  {len(here):5d}  {proved:6d}  "
                f"{np.median(here):11.2f}  {np.quantile(here, 0.99):10.2f}  "
                f"{np.median(nodes):13.0f}  {np.quantile(nodes, 0.99):5.0f}  "
                f"{1e-3 * np.median(here) / own:11.2f}  {max(off, default=0.0):11.1e}",
                file=stream,
            )


Rows = dict[tuple[Method, str], tuple[list[float], list[MethodResult], list[float]]]


def _measured(horizon: int, seed: int, ticks: int) -> Rows:
    """Seconds, answers and differences of costs, by method and what it begins with."""
    problem, plant = moving_walls(horizon), Plant(seed)
    memories = {m: ProblemSequence(problem, _SETTINGS, m) for m in METHODS}
    rows: Rows = {(m, begun): ([], [], []) for m in METHODS for begun in ("nothing", "the last")}
    for method in METHODS:  # compiles where it has to
        solve_instance(problem, {"start": plant.state, "walls": plant.walls}, method, _SETTINGS)
    for tick in range(ticks):
        theta = {"start": plant.state, "walls": plant.walls}
        best: float | None = None
        force = 0.0
        for (method, begun), (seconds, found, off) in rows.items():
            begin = time.process_time()
            if begun == "nothing":
                one = solve_instance(problem, theta, method, _SETTINGS)
            else:
                one = memories[method].solve(theta, min(tick, 1))
            seconds.append(time.process_time() - begin)
            found.append(one)
            cost, x = one.result.objective, one.result.x
            if best is None and cost is not None and x is not None:
                best, force = cost, float(problem.values(x)["input"][0, 0])
            if best is not None and cost is not None:
                off.append(abs(cost - best) / max(abs(best), _REST))
        plant.tick(force)
        if plant.fallen:
            plant.stand_up()
    return rows
