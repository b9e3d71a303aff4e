"""`qplib`: convex mixed-integer and mixed-binary bilinear instances of QPLIB, by three solvers.

The files are not part of the project: an option names their folder (http://qplib.zib.de, CC BY
4.0). Rows are kept in another one, so that a run goes on where the last one ended.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from benchmarks.kept_rows import read_rows, write_rows
from climbplan.errors import UsageError
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings
from climbplan.program.problem import Problem
from climbplan.solvers.model_files.reading import problem_from_file

FILE = "qplib.csv"
BEST_KNOWN = {  # published objective values
    "QPLIB_2882": 22.38189652,
    "QPLIB_2958": 131.6531381,
    "QPLIB_3562": 15.0,
    "QPLIB_3680": 347691.4107,
    "QPLIB_3728": 205054.4585,
    "QPLIB_3748": 281408.6353,
    "QPLIB_3814": 0.6259674725,
    "QPLIB_3913": 42.925,
    "QPLIB_3980": 6.325,
    "QPLIB_8153": -1.076351999,
}
SOLVERS: dict[str, Method] = {
    "climbplan": "auto",
    "scip": "minlp-scip",
    "highs": "mccormick",
}
TIME_LIMIT, QUICK_LIMIT = 60.0, 2.0  # [s]
_CLOSE = 1e-4  # relative distance from the best value that counts as an optimum


@dataclass(frozen=True)
class QplibRow:
    """What one solver did on one instance; NaN where it found no point."""

    instance: str
    solver: str
    seconds: float  # of the processor
    status: str
    objective: float
    bound: float


def run_qplib(
    quick: bool, stream: TextIO, folder: Path, out: Path | None, limit: float | None
) -> None:
    """Print a row for each instance and solver, and a summary.

    HiGHS takes instances without products only; others are left out for it.
    """
    files = [path for path in sorted(folder.glob("*.qplib")) if path.stem in BEST_KNOWN]
    if not files:
        print(f"{folder}: no QPLIB files of this subset there: give --folder DIR", file=stream)
        return
    limit = (QUICK_LIMIT if quick else TIME_LIMIT) if limit is None else limit
    rows = [] if out is None else read_rows(out / FILE, QplibRow)
    print(
        f"QPLIB, gap 1e-4, {limit:g} s of the clock at most\n"
        "instance      solver       CPU [s]  status       objective       bound           best",
        file=stream,
    )
    for path in files:
        problem = problem_from_file(path)
        for solver, method in SOLVERS.items():
            if solver == "highs" and problem.instance({}).products.count:
                continue
            measured = {(row.instance, row.solver): row for row in rows}
            row = measured.get((path.stem, solver))
            if row is None:
                row = _measure(path.stem, problem, solver, method, limit)
                rows.append(row)
                if out is not None:
                    write_rows(out / FILE, rows)
            print(
                f"{row.instance:<13} {row.solver:<11} {row.seconds:8.1f}  {row.status:<11}  "
                f"{row.objective:<14.8g}  {row.bound:<14.8g}  {BEST_KNOWN[row.instance]:.8g}",
                file=stream,
            )
    _print_summary(rows, stream)


def _measure(name: str, problem: Problem, solver: str, method: Method, limit: float) -> QplibRow:
    """Solve one instance by one solver."""
    begin = time.process_time()
    settings = MethodSettings(gap=_CLOSE, time_limit=limit)
    try:
        result = solve_instance(problem, {}, method, settings).result
    except UsageError:  # as where nothing bounds a factor
        seconds = time.process_time() - begin
        return QplibRow(name, solver, seconds, "refused", np.nan, -np.inf)
    return QplibRow(
        instance=name,
        solver=solver,
        seconds=time.process_time() - begin,
        status=result.status,
        objective=np.nan if result.objective is None else result.objective,
        bound=result.bound,
    )


def _print_summary(rows: list[QplibRow], stream: TextIO) -> None:
    """Print how many instances each solver proved, and what is wrong."""
    print("\nsolver       instances  proved  best value  bounds above the best value", file=stream)
    for solver in SOLVERS:
        results = [row for row in rows if row.solver == solver]
        slack = {row.instance: _CLOSE * abs(BEST_KNOWN[row.instance]) for row in results}
        best = sum(
            row.objective <= BEST_KNOWN[row.instance] + slack[row.instance] for row in results
        )
        above = sum(row.bound > BEST_KNOWN[row.instance] + slack[row.instance] for row in results)
        proved = sum(row.status == "optimal" for row in results)
        print(f"{solver:<11}  {len(results):9d}  {proved:6d}  {best:10d}  {above:27d}", file=stream)
