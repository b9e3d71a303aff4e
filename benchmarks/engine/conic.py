"""`conic`: random mixed-integer programs through CVXPY, by our solver and by SCIP.

Quadratic and conic costs in turn. The value is compared with the better of the others, and no bound
may lie above it.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from typing import Any, TextIO

import cvxpy
import numpy as np

import climbplan

COUNT, QUICK_COUNT = 200, 10
cp: Any = cvxpy  # whose functions have no types
_GAP = 1e-4
_OFF = 1e-3  # relative: a value or a bound so far off is wrong
_LIMIT = 30.0  # [s]


@dataclass
class _Column:
    """What one solver did: processor seconds, wrong answers, and answers without a proof."""

    seconds: list[float] = field(default_factory=list)
    wrong: int = 0
    unproved: int = 0


def generate_problem(rng: np.random.Generator, conic: bool) -> Any:
    """A sparse regression with integer offsets, within cones where `conic`."""
    n, m = int(rng.integers(3, 8)), int(rng.integers(2, 4))
    x, z = cp.Variable(n), cp.Variable(n, boolean=True)
    y = cp.Variable(m, integer=True)
    A, B = rng.normal(size=(n + 2, n)), rng.normal(size=(n + 2, m))
    residual = A @ x + B @ y - 2.0 * rng.normal(size=n + 2)
    rows = [cp.abs(x) <= 3.0 * z, cp.abs(y) <= 4, cp.sum(z) <= n // 2 + 1]
    cost = cp.norm(residual) if conic else cp.sum_squares(residual)
    if conic:
        rows.append(cp.norm(x - rng.normal(size=n)) <= 2.0 + 0.3 * cp.sum(y))
    return cp.Problem(cp.Minimize(cost + rng.random(n) @ z), rows)


def run_conic(seed: int, quick: bool, stream: TextIO) -> None:
    """Print a table of solvers."""
    ours = climbplan.CVXPY(gap=_GAP, time_limit=_LIMIT)
    for kind, conic in (("quadratic", False), ("conic", True)):
        columns = {"climbplan": _Column(), "scip": _Column()}
        for number in range((QUICK_COUNT if quick else COUNT) // 2):
            problem = generate_problem(np.random.default_rng([seed, number, conic]), conic)
            answers: dict[str, tuple[str, float]] = {}
            for name, solver, options in (
                ("scip", cp.SCIP, {"scip_params": {"limits/time": _LIMIT}}),
                ("climbplan", ours, {}),
            ):
                begin = time.process_time()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    problem.solve(solver=solver, **options)
                columns[name].seconds.append(time.process_time() - begin)
                value = np.inf if problem.value is None else float(problem.value)
                answers[name] = problem.status, value
            bound = problem.solver_stats.extra_stats["bound"]
            _compare(columns, answers, bound)
        _print_table(kind, columns, stream)


def _compare(
    columns: dict[str, _Column], answers: dict[str, tuple[str, float]], bound: float
) -> None:
    """Count wrong and unproved answers."""
    best = min(value for _, value in answers.values())
    for name, (status, value) in answers.items():
        column, slack = columns[name], _OFF * max(abs(best), 1e-3) if np.isfinite(best) else 0.0
        column.unproved += status not in ("optimal", "infeasible")
        is_off = status in ("optimal", "infeasible") and value > best + slack
        column.wrong += bool(is_off or (name == "climbplan" and bound > best + slack))


def _print_table(kind: str, columns: dict[str, _Column], stream: TextIO) -> None:
    """Print a line for each solver, with the ratio of medians to SCIP's."""
    base = float(np.median(columns["scip"].seconds))
    for name, column in columns.items():
        median = float(np.median(column.seconds))
        print(
            f"{kind:<10} {name:<10} {len(column.seconds):4d} problems, {column.wrong} wrong, "
            f"{column.unproved} unproved, median {1e3 * median:8.2f} ms, "
            f"99 % {1e3 * np.quantile(column.seconds, 0.99):9.2f} ms, of scip {median / base:.2f}",
            file=stream,
        )
