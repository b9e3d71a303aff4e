"""Comparison of ways to solve the force problems of one climb (`force`)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from benchmarks.climb.literal_solvers import LiteralAnswer, solve_cvxpy, solve_literal
from climbplan.arrays import Array
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import (
    ForceStatement,
    build_force_statement,
    compute_objective,
)
from climbplan.climb.forces.unreduced import UnreducedProblem, build_unreduced_problems
from climbplan.errors import LimitReached, MissingSolver
from climbplan.instances.straight_climb import build_straight_climb

# Table 5.1 of the dissertation: 96 problems of 61 variables with four-sided pyramids
PUBLISHED_MS, PUBLISHED_BY = 960.0, "Gurobi, published for an i7-8750H (Table 5.1)"


@dataclass(frozen=True)
class _Row:
    name: str
    ms: float  # for all instants
    objective: Array  # (K,) NaN for instants left out


def bench_force(seed: int, quick: bool, out: TextIO) -> None:
    """Print times and optima of four ways to solve the same force problems in the same run.

    Times are medians and include building the problems from the planned instants. quick: fewer
    repeats, and CVXPY on every eighth instant only.
    """
    climb = build_straight_climb(seed)
    statement = build_force_statement(climb.scene, climb.instants).as_published()
    facets = climb.scene.spec.force.facets
    count = climb.instants.count
    repeats = 5 if quick else 15

    def ours(solver: str) -> Callable[[], Array]:
        def run() -> Array:
            fresh = build_force_statement(climb.scene, climb.instants).as_published()
            solved = solve_forces(fresh, solver, facets)
            if len(solved.missing):
                raise LimitReached(f"{solver} left {len(solved.missing)} instants unsolved")
            return solved.force

        return run

    rows = [
        _timed(f"climbplan: eliminated, {facets} facets, DAQP", ours("daqp"), repeats, statement),
        _timed("eliminated, exact cones, Clarabel", ours("clarabel"), repeats, statement),
        _timed(
            "literal 61 variables, exact cones, Clarabel",
            lambda: _literal(statement, solve_literal, 1),
            max(3, repeats // 3),
            statement,
        ),
    ]
    stride = 8 if quick else 1
    name = "literal, CVXPY, one call each"
    name += f" ({count // stride} of {count}, scaled)" if quick else ""
    try:
        row = _timed(
            name,
            lambda: _literal(statement, solve_cvxpy, stride),
            1,
            statement,
        )
        rows.append(_Row(name, row.ms * stride, row.objective))
    except MissingSolver as error:
        out.write(f"left out: {error}\n")
    _print(rows, count, out)
    whole = _median(lambda: plan_forces(climb.scene, climb.instants), repeats)
    out.write(f"with commands within bounds, stability and safety factors: {whole:.1f} ms\n")


def _literal(
    statement: ForceStatement,
    solve: Callable[[UnreducedProblem], LiteralAnswer | None],
    stride: int,
) -> Array:
    """Forces by a literal form, NaN for the instants left out or without an answer."""
    force = np.full(statement.arms.shape, np.nan)
    for k, problem in enumerate(build_unreduced_problems(statement)):
        if k % stride == 0 and (answer := solve(problem)) is not None:
            force[k] = answer.force
    return force


def _median(run: Callable[[], object], repeats: int) -> float:
    """Median time [ms]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def _timed(name: str, run: Callable[[], Array], repeats: int, statement: ForceStatement) -> _Row:
    force = run()  # also warms up
    return _Row(name, _median(run, repeats), compute_objective(statement, force))


def _print(rows: list[_Row], count: int, out: TextIO) -> None:
    exact = rows[1].objective
    out.write(f"force planner, {count} instants (one thread)\n")
    out.write(f"{'':<46}{'ms':>9}{'us each':>9}{'ratio':>8}{'objective off by':>18}\n")
    for row in rows:
        off = np.nanmax(np.abs(row.objective / exact - 1))
        out.write(
            f"{row.name:<46}{row.ms:>9.1f}{1e3 * row.ms / count:>9.0f}"
            f"{row.ms / rows[0].ms:>8.1f}{off:>18.1e}\n"
        )
    out.write(f"{PUBLISHED_BY:<46}{PUBLISHED_MS:>9.1f}{1e3 * PUBLISHED_MS / count:>9.0f}\n")
