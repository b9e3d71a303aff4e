"""`conic`: problems with integers through CVXPY, by our solver and others.

Random programs, then published kinds of problems (`stated_problems`), each in a size that Gurobi's
licence without charge admits and in a larger one. The value is compared with the best of all
solvers, and our bound may not lie above it. HiGHS takes neither quadratic costs nor cones with
integers. DAQP has no cones, and shows no bound: none of its answers counts as proved.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable
from ctypes import c_int
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, TextIO

import cvxpy
import daqp
import numpy as np

import climbplan
from benchmarks.engine.stated_problems import STATED_PROBLEMS
from climbplan.program.cvxpy_form import ConicForm, build_conic_instance

cp: Any = cvxpy  # whose functions have no types
COUNT, QUICK_COUNT = 200, 10
STATED_COUNT, QUICK_STATED_COUNT = 5, 1  # problems of a kind and size
_GAP = 1e-4
_OFF = 1e-3  # relative: a value or a bound so far off is wrong
_LIMIT = 30.0  # [s]
_STATED_LIMIT, _QUICK_LIMIT = 10.0, 2.0  # [s]
_OURS = "climbplan"
_BINARY, _EQUATION = 16, 5  # DAQP's flags
_PROVED = ("optimal", "optimal_inaccurate", "infeasible")


@dataclass(frozen=True)
class _Answer:
    """What a solver says of a problem; infinite values where it has no point."""

    status: str
    value: float
    bound: float = -np.inf


Contender = Callable[[Any], _Answer]


@dataclass
class _Column:
    """What one solver did: processor seconds, proofs, wrong answers, and its worst value."""

    seconds: list[float] = field(default_factory=list)
    proved: int = 0
    wrong: int = 0
    worst: float = 0.0  # relative distance of a value from the best; infinite without a point


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
    """Print a row for each kind of problem and solver."""
    count = (QUICK_COUNT if quick else COUNT) // 2
    stated_count = QUICK_STATED_COUNT if quick else STATED_COUNT
    limit = _QUICK_LIMIT if quick else _STATED_LIMIT
    has_gurobi = find_spec("gurobipy") is not None
    print(
        f"problems with integers through CVXPY, gap {_GAP:g}, at most {limit:g} s of the clock "
        f"(random ones {_LIMIT:g} s), one thread\n"
        + ("" if has_gurobi else "Gurobi is not installed and has no rows\n")
        + "problem              solver      problems  proved  wrong  cost off by  "
        "median [ms]  99 % [ms]  of ours",
        file=stream,
    )
    for kind, conic in (("random, quadratic", False), ("random, conic", True)):
        problems = (
            generate_problem(np.random.default_rng([seed, number, conic]), conic)
            for number in range(count)
        )
        _compare_solvers(kind, problems, _list_contenders(_LIMIT, False, False), stream)
    for stated in STATED_PROBLEMS:
        problems = (
            stated.generate(np.random.default_rng([seed, number]), **stated.sizes)
            for number in range(stated_count)
        )
        gurobi = has_gurobi and stated.fits_licence
        contenders = _list_contenders(limit, not stated.name.startswith("GCS"), gurobi)
        _compare_solvers(stated.name, problems, contenders, stream)


def _list_contenders(limit: float, takes_daqp: bool, takes_gurobi: bool) -> dict[str, Contender]:
    """Return the solvers of a kind of problem, each with a time limit [s]."""
    ours = climbplan.CVXPY(gap=_GAP, time_limit=limit)
    scip = {"scip_params": {"limits/time": limit, "limits/gap": _GAP}}
    gurobi = {"TimeLimit": limit, "MIPGap": _GAP, "Threads": 1}
    contenders: dict[str, Contender] = {
        "scip": lambda problem: _solve_by_cvxpy(problem, cp.SCIP, scip, limit),
        _OURS: lambda problem: _solve_by_cvxpy(problem, ours, {}, limit),
    }
    if takes_daqp:
        contenders["daqp"] = lambda problem: _solve_daqp(problem, limit)
    if takes_gurobi:
        contenders["gurobi"] = lambda problem: _solve_by_cvxpy(problem, cp.GUROBI, gurobi, limit)
    return contenders


def _solve_by_cvxpy(problem: Any, solver: Any, options: dict[str, Any], limit: float) -> _Answer:
    """Solve a problem by a solver of CVXPY, which may take `limit` [s]."""
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=solver, **options)
    except cp.error.SolverError:  # no point within the limit
        return _Answer("limit", np.inf)
    value = np.inf if problem.value is None else float(problem.value)
    figures = problem.solver_stats.extra_stats
    bound = figures["bound"] if isinstance(figures, dict) and "bound" in figures else -np.inf
    # CVXPY reports SCIP's limits of gap and time alike
    is_stopped = problem.status == "optimal_inaccurate" and time.perf_counter() - begin >= limit
    return _Answer("limit" if is_stopped else problem.status, value, bound)


def _solve_daqp(problem: Any, limit: float) -> _Answer:
    """Solve a quadratic problem with binaries by DAQP's own branch and bound."""
    instance = build_conic_instance(problem.get_problem_data(ConicForm())[0], "daqp")
    is_equation = instance.row_lower == instance.row_upper
    sense = np.where(instance.integer, _BINARY, 0)
    x, _, code, _ = daqp.solve(
        instance.P.toarray(),
        instance.q,
        np.ascontiguousarray(instance.A.toarray()),
        np.minimum(np.concatenate([instance.upper, instance.row_upper]), 1e30),
        np.maximum(np.concatenate([instance.lower, instance.row_lower]), -1e30),
        np.concatenate([sense, np.where(is_equation, _EQUATION, 0)]).astype(c_int),
        rel_subopt=_GAP,
        time_limit=limit,
    )
    if code <= 0 or instance.violation(np.asarray(x)) > 1e-4:
        return _Answer("limit", np.inf)
    return _Answer("feasible", instance.objective(np.asarray(x)))


def _compare_solvers(
    kind: str, problems: Iterable[Any], contenders: dict[str, Contender], stream: TextIO
) -> None:
    """Solve problems by all contenders, and print a row for each."""
    columns = {name: _Column() for name in contenders}
    for problem in problems:
        answers: dict[str, _Answer] = {}
        for name, contender in contenders.items():
            begin = time.process_time()
            answers[name] = contender(problem)
            columns[name].seconds.append(time.process_time() - begin)
        _judge_answers(columns, answers)
    median = float(np.median(columns[_OURS].seconds))
    for name, column in columns.items():
        milliseconds = 1e3 * np.array(column.seconds)
        print(
            f"{kind:<19}  {name:<10}  {len(milliseconds):8d}  {column.proved:6d}  "
            f"{column.wrong:5d}  {column.worst:11.1e}  {np.median(milliseconds):11.1f}  "
            f"{np.quantile(milliseconds, 0.99):9.1f}  "
            f"{np.median(column.seconds) / median:7.2f}",
            file=stream,
            flush=True,
        )


def _judge_answers(columns: dict[str, _Column], answers: dict[str, _Answer]) -> None:
    """Count proofs, and answers that are not as good as they claim."""
    best = min(answer.value for answer in answers.values())
    slack = _OFF * max(abs(best), 1e-3) if np.isfinite(best) else 0.0
    for name, answer in answers.items():
        is_proved = answer.status in _PROVED
        columns[name].proved += is_proved
        is_off = is_proved and answer.value > best + slack
        columns[name].wrong += bool(is_off or answer.bound > best + slack)
        off = 0.0 if np.isinf(best) else (answer.value - best) / max(abs(best), 1e-3)
        columns[name].worst = max(columns[name].worst, off)
