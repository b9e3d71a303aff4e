"""`engine`, second table: walls that move, controlled at 50 Hz for 100 s.

Each tick takes the statement's coefficients, solves with what the last tick left and reads the
answer; all of it is timed, in CPU milliseconds. The tree may make so many dual steps and then
answers with the best that it has, so that the controlled motion is the same whatever the load.
Where there is no answer the last plan goes on. Some ticks are solved to the gap from nothing, too:
how far the answers are from the optimum in truth.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TextIO

import numpy as np

from benchmarks.engine.moving_walls import TICK, Plant, moving_walls
from climbplan.methods.sequence import ProblemSequence
from climbplan.methods.task import MethodSettings
from climbplan.solvers.mixed_integer.method import solve_mixed_integer

HORIZONS = (10, 20)  # steps; 10 as published
SECONDS, QUICK_SECONDS = 100.0, 4.0  # simulated
WORK = 1000  # dual steps of a tick
_GAP, _TOLERANCE = 1e-3, 1e-6
_EVERY = 20  # ticks of which one is solved from nothing
_REST = 1e-3  # cost of next to no motion, from which on differences are relative to it


@dataclass
class Ticks:
    """What a controller did."""

    spent: list[float] = field(default_factory=list)  # [s]
    cold: list[float] = field(default_factory=list)  # [s] of the ticks solved from nothing
    nodes: list[int] = field(default_factory=list)
    status: Counter[str] = field(default_factory=Counter)
    gap: list[float] = field(default_factory=list)
    off: list[float] = field(default_factory=list)  # relative, of ticks solved from nothing
    in_contact: int = 0  # ticks whose plan touches a wall
    falls: int = 0

    @property
    def missed(self) -> int:
        """Ticks that took longer than they last."""
        return int(np.sum(np.array(self.spent) > TICK))


def controlled(horizon: int, seed: int, seconds: float, work: int = WORK) -> Ticks:
    """Control the plant for so long [s] of simulated time."""
    problem, plant, ticks = moving_walls(horizon), Plant(seed), Ticks()
    settings = MethodSettings(gap=_GAP, tolerance=_TOLERANCE, work=work)
    sequence = ProblemSequence(problem, settings)
    for shift in range(2):  # compiles where it has to
        sequence.solve({"start": plant.state, "walls": plant.walls}, shift)
    sequence.reset()
    plan = np.zeros(0)
    for number in range(round(seconds / TICK)):
        theta = {"start": plant.state, "walls": plant.walls}
        begin = time.process_time()
        found = sequence.solve(theta, horizon_shift=min(number, 1)).result
        if found.x is not None:
            values = problem.values(found.x)
            plan = values["input"][:, 0]
        else:
            plan = plan[1:]
        ticks.spent.append(time.process_time() - begin)
        ticks.nodes.append(found.nodes)
        ticks.status[found.status] += 1
        if found.x is not None and found.gap is not None:
            ticks.gap.append(found.gap)
            ticks.in_contact += bool(values["touch"].max() > 0.5)
        if number % _EVERY == 0:
            begin = time.process_time()
            best = solve_mixed_integer(problem.instance(theta), _GAP, tolerance=_TOLERANCE)
            ticks.cold.append(time.process_time() - begin)
            if found.objective is not None and best.objective is not None:
                scale = max(abs(best.objective), _REST)
                ticks.off.append((found.objective - best.objective) / scale)
        plant.tick(float(plan[0]) if len(plan) else 0.0)
        if plant.fallen:
            ticks.falls += 1
            plant.stand_up()
            sequence.reset()
            plan = np.zeros(0)
    return ticks


def run_ticks(seed: int, quick: bool, stream: TextIO) -> None:
    """Print one row for each horizon."""
    seconds = QUICK_SECONDS if quick else SECONDS
    print(
        f"\nmoving walls, 50 Hz, {seconds:.0f} s simulated, at most {WORK} dual steps a tick\n"
        "steps  ticks  missed  median [ms]   99 % [ms]  longest  cold, median   99 %  nodes   99 %"
        "  proved  feasible  infeasible  nothing  gap, 99 %  cost off by  touching  falls",
        file=stream,
    )
    for horizon in HORIZONS:
        t = controlled(horizon, seed, seconds)
        spent, cold = 1e3 * np.array(t.spent), 1e3 * np.array(t.cold)
        print(
            f"{horizon:5d}  {len(spent):5d}  {t.missed:6d}  {np.median(spent):11.2f}  "
            f"{np.quantile(spent, 0.99):10.2f}  {spent.max():7.1f}  {np.median(cold):12.2f}  "
            f"{np.quantile(cold, 0.99):5.1f}  {np.median(t.nodes):5.0f}  "
            f"{np.quantile(t.nodes, 0.99):5.0f}  {t.status['optimal']:6d}  "
            f"{t.status['feasible']:8d}  {t.status['infeasible']:10d}  {t.status['limit']:7d}  "
            f"{np.quantile(t.gap, 0.99):9.1e}  {max(t.off, default=0.0):11.1e}  "
            f"{t.in_contact / len(spent):8.0%}  {t.falls:5d}",
            file=stream,
        )
