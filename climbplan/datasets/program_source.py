"""Rows of a stated program, as a worker makes them: CasADi and solvers are loaded here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from climbplan.datasets.schema.model import ProgramProblemSpec
from climbplan.methods.dataset_rows import ProgramRows
from climbplan.methods.run import build_settings
from climbplan.methods.solved import read_library, read_strategy_model
from climbplan.program.problem import Problem


def build_program_source(
    load: Callable[[], Problem], spec: ProgramProblemSpec, directory: Path
) -> ProgramRows:
    """Return a stated problem; `load` imports it. The spec's files are looked up from `directory`.

    Raises PlanFileError or UsageError for a library or model that does not serve the problem.
    """
    problem, solver = load(), spec.solver
    library = None if solver.library is None else read_library(problem, directory / solver.library)
    model = (
        None
        if solver.model is None
        else read_strategy_model(problem, directory / solver.model.file)
    )
    return ProgramRows(problem, solver.method, build_settings(solver, library, model))
