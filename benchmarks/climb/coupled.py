"""The coupled planner: two stages against CVXPY, the accurate MICP, and random slippery patches."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import TextIO, TypeVar

import numpy as np

from benchmarks.climb.coupled_cvxpy import cvxpy_stages
from benchmarks.climb.coupled_layouts import bench_layouts
from benchmarks.climb.coupled_micp import bench_micp
from climbplan.arrays import Array
from climbplan.climb.coupled.envelopes import select_envelopes
from climbplan.climb.coupled.preparation import CoupledProblem, prepare_problem
from climbplan.climb.coupled.stages import solve_first_stage, solve_second_stage
from climbplan.climb.coupled.statement import compute_envelope_range
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import load_text
from climbplan.errors import LimitReached
from climbplan.schema.examples import read_example
from climbplan.solvers.ipopt.instances import solve_ipopt

Answer = TypeVar("Answer")

PUBLISHED = "published 160 ms: Gurobi through its interface, i5-6260U (Table 5.3)"


def prepared_patches(rounds: int, seed: int) -> CoupledProblem:
    """climb_patches over more rounds, payload by seed."""
    mass = float(np.random.default_rng(seed).uniform(0.0, 1.5))
    given = [f"task.rounds={rounds}", f"task.payload.mass={mass:.3f}"]
    loaded = load_text(read_example("climb_patches"), "climb_patches", given)
    return prepare_problem(build_scene(loaded.spec, loaded.robot, loaded.source), PostureMargins())


def bench_coupled(seed: int, quick: bool, out: TextIO) -> None:
    """Print the two stages against CVXPY and IPOPT, the accurate MICP, then random patches."""
    _stages(seed, 3 if quick else 9, out)
    bench_micp(seed, quick, out)
    bench_layouts(seed, 2 if quick else 50, out)


def _stages(seed: int, repeats: int, out: TextIO) -> None:
    prepared = prepared_patches(8, seed)
    envelope = select_envelopes(prepared.scene)[0]
    pinned = prepared.fix_choices(prepared.guess, prepared.assignment)
    x: Array | None = None

    def both() -> Array:
        nonlocal x
        x = solve_first_stage(prepared, pinned, envelope.box)
        answer = None if x is None else solve_second_stage(prepared.program, pinned, x)
        if answer is None:
            raise LimitReached("the instance has no answer by two stages")
        return answer

    ours, answer = timed(both, repeats)
    cost = pinned.objective(answer)
    gap = max(0.0, cost - prepared.bound) / max(abs(cost), 1e-9)
    print(f"coupled planner, 8 rounds, CPU time of one thread; {PUBLISHED}", file=out)
    print(f"{'':<42}{'ms':>9}{'ratio':>8}{'cost':>12}", file=out)
    _row(out, "P1 (Clarabel) and P2 (HiGHS)", ours, ours, cost)
    if find_spec("cvxpy") is not None:
        within = compute_envelope_range(prepared.program, pinned, envelope.box, prepared.origin)
        force = prepared.program.variables["force"]
        for name, one_by_one in (
            ("the same through CVXPY, ball by ball", True),
            ("the same through CVXPY, our matrices", False),
        ):
            cvxpy_stages(pinned, within, force, one_by_one)  # imports and first calls apart
            run = partial(cvxpy_stages, pinned, within, force, one_by_one)
            theirs, value = timed(run, repeats)
            _row(out, name, theirs, ours, value)
    else:
        print("left out: CVXPY is not installed", file=out)
    start = x if x is not None else answer
    whole, local = timed(lambda: solve_ipopt(pinned, start=start), 1)
    if local.objective is not None:
        _row(out, "IPOPT on everything, from P1", whole, ours, local.objective)
    print(f"gap of the two stages to postures without forces: {gap:.1e}", file=out)


def _row(out: TextIO, name: str, ms: float, ours: float, cost: float) -> None:
    print(f"{name:<42}{ms:>9.1f}{ms / ours:>8.1f}{cost:>12.6f}", file=out)


def timed(run: Callable[[], Answer], repeats: int) -> tuple[float, Answer]:
    """Median CPU time [ms], which other processes do not lengthen, and the last answer."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        answer = run()
        times.append(time.process_time() - begin)
    return 1e3 * statistics.median(times), answer
