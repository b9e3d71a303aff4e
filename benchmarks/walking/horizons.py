"""QPs of one gait over horizons: states eliminated (DAQP) against states as unknowns (PIQP)."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

import numpy as np

from benchmarks.walking.shipped_tasks import shipped_task
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.gaits import assign_regions, repeat_gait
from climbplan.walking.offline.sqp import guess_iterate, interpolate_iterates
from climbplan.walking.offline.staged_qp import StagedContactProgram

_KNOTS, _QUICK = (9, 15, 20, 24, 30, 40), (9, 24)
_GAITS = ("trot", "walk")
_QPS, _WARM = 8, 2  # QPs of a sequence, and those before the median of warm ones
_STEP = 0.7  # of the way from one iterate to the next


def horizon_table(seed: int, quick: bool, jobs: int, stream: TextIO) -> None:
    """Print CPU times of both forms of the QPs of a sequence, and their costs."""
    print(
        "mpc_forward, CPU [ms] of the first QP and the median of later ones\n"
        "gait  knots  eliminated: first   later  unknowns: first   later  later/later  "
        "cost/cost - 1",
        file=stream,
    )
    for gait in _GAITS:
        _measure(gait, _KNOTS[0])  # compiles
        for knots in _QUICK if quick else _KNOTS:
            dense, staged = _measure(gait, knots)
            print(
                f"{gait:<5} {knots:5d}  {dense[0]:17.1f}  {dense[1]:6.1f}  {staged[0]:15.1f}  "
                f"{staged[1]:6.1f}  {staged[1] / dense[1]:11.2f}  {staged[2] / dense[2] - 1:13.1e}",
                file=stream,
                flush=True,
            )


def _measure(name: str, knots: int) -> tuple[tuple[float, float, float], ...]:
    """Return first and later times [ms] and the last cost, by the dense and the sparse QP."""
    task = shipped_task("mpc_forward", f"task.knots={knots}")
    gait = assign_regions(task, repeat_gait(name, task.body.leg_count, knots))
    rows = []
    for kind in (FixedContactProgram, StagedContactProgram):
        program = kind(task, gait)
        times, last = _run_sequence(program.solve_qp, guess_iterate(task, gait))
        cost = program.compute_cost(last.state, last.force)
        rows.append((times[0], float(np.median(times[_WARM:])), cost))
    return tuple(rows)


def _run_sequence(
    solve: Callable[[WalkIterate, bool], WalkIterate | None], iterate: WalkIterate
) -> tuple[list[float], WalkIterate]:
    """Return the CPU times [ms] of a sequence of QPs and its last iterate."""
    times = []
    for _ in range(_QPS):
        begin = time.process_time()
        solution = solve(iterate, True)
        times.append(1e3 * (time.process_time() - begin))
        if solution is None:
            break
        iterate = interpolate_iterates(iterate, solution, _STEP)
    return times, iterate
