"""Rows of a stated program, as a worker makes them: CasADi and solvers are loaded here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from climbplan.learning.dataset_rows import ProgramRows
from climbplan.learning.program_run import library_of, settings_of
from climbplan.program.problem import Problem
from climbplan.spec.dataset import ProgramProblemSpec


def program_source(
    load: Callable[[], Problem], spec: ProgramProblemSpec, library: Path | None
) -> ProgramRows:
    """A stated problem; `load` imports it. `library`: solved rows for methods that need them."""
    problem = load()
    solved = None if library is None else library_of(problem, library)
    return ProgramRows(problem, spec.solver.method, settings_of(spec.solver, solved))
