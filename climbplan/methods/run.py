"""Solve the instances of a program spec, into one plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.sequence import ProblemSequence
from climbplan.methods.solved import read_library, read_strategy_model
from climbplan.methods.table import MethodResult, solve_instance
from climbplan.methods.task import MethodSettings, SharedCache
from climbplan.program.problem import Problem, StatementError, Theta
from climbplan.progress import Progress
from climbplan.schema.program.loading import LoadedProgram
from climbplan.schema.program.model import ProgramSolverSpec
from climbplan.store.program_plan import Layouts, ProgramPlan


@dataclass(frozen=True)
class SolvedRows:
    """The plan and each row's result, in order."""

    plan: ProgramPlan
    rows: tuple[MethodResult, ...]


def generate_thetas(problem: Problem, loaded: LoadedProgram) -> tuple[dict[str, Array], ...]:
    """Return the parameters of a spec, sampled or written out.

    Raises:
        SpecError: Written parameters do not fit.
        StatementError: The sampler is wrong.
    """
    spec = loaded.spec
    if spec.sample is not None:
        rng = np.random.default_rng(spec.seed)
        return tuple(problem.sample_parameters(rng) for _ in range(spec.sample.count))
    thetas, mistakes = [], []
    for k, blocks in enumerate(spec.thetas):
        try:
            thetas.append(problem.numbers({name: np.array(v) for name, v in blocks.items()}))
        except StatementError:
            raise
        except (UsageError, ValueError) as error:  # ValueError: ragged lists
            place = f"theta.{k}" if isinstance(spec.theta, list) else "theta"
            mistakes.append(SpecMistake(place, str(error)))
    if mistakes:
        raise loaded.locate(SpecError(loaded.source, mistakes))
    return tuple(thetas)


def build_settings(
    solver: ProgramSolverSpec, library: Library | None, model: StrategyModel | None = None
) -> MethodSettings:
    """Build a method's settings from a spec."""
    shape = solver.envelopes
    return MethodSettings(
        solver=solver.solver,
        gap=solver.gap,
        time_limit=solver.time_limit,
        tolerance=solver.tolerance,
        start=solver.start,
        neighbours=solver.neighbours,
        fallback=None if solver.fallback == "none" else solver.fallback,
        library=library,
        model=model,
        envelopes=EnvelopeOptions(
            pieces=shape.pieces,
            rounds=shape.rounds,
            disjunctions=shape.disjunctions,
            encoding=shape.encoding,
        ),
    )


def solve_spec(
    problem: Problem,
    loaded: LoadedProgram,
    report: Progress | None = None,
    shift: int | None = None,
    certificate: bool = False,
) -> SolvedRows:
    """Solve every instance of a spec; rows without an answer are kept without one.

    Args:
        problem: The problem.
        loaded: The spec.
        report: Progress callback.
        shift: Steps by which the horizon recedes from row to row, each warm-started by the last;
            None for independent rows.
        certificate: Whether results come with a proof of their bounds.

    Raises:
        SpecError: Written parameters do not fit.
        UsageError: A file or setting does not fit the problem.
    """
    solver = loaded.spec.solver
    thetas = generate_thetas(problem, loaded)
    library = None if loaded.library is None else read_library(problem, loaded.library)
    model = None if loaded.model is None else read_strategy_model(problem, loaded.model)
    settings = replace(build_settings(solver, library, model), certificate=certificate)
    sequence = None
    if shift is not None:
        sequence = ProblemSequence(problem, settings, solver.method)
    results, shared = [], SharedCache()
    for k, theta in enumerate(thetas):
        if report is not None:
            report("solve", k / len(thetas))
        if sequence is None:
            results.append(solve_instance(problem, theta, solver.method, settings, shared))
        else:
            results.append(sequence.solve(theta, (shift or 0) if k else 0))
    return SolvedRows(_build_plan(problem, loaded, thetas, results), tuple(results))


def _build_plan(
    problem: Problem,
    loaded: LoadedProgram,
    thetas: Sequence[Theta],
    results: Sequence[MethodResult],
) -> ProgramPlan:
    """Build the plan of solved rows."""
    answers = [r.result for r in results]
    size, choices = len(answers), _count_choices(problem)
    width = int(sum(v.lower.size for v in problem.program.variables.values()))
    x = np.full((size, width), np.nan)
    assignment = np.full((size, choices), -1, np.int64)
    for k, answer in enumerate(answers):
        if answer.x is not None and answer.assignment is not None:
            x[k], assignment[k] = answer.x, answer.assignment
    times = np.array([r.time for r in results])
    counts = problem.program.counts()
    return ProgramPlan(
        problem=problem.name,
        layouts=Layouts.of(problem.program),
        parameters=np.array([problem.program.theta(theta) for theta in thetas]),
        features=np.array([problem.feature_vector(theta) for theta in thetas]),
        x=x,
        assignment=assignment,
        found=np.array([answer.x is not None for answer in answers]),
        status=tuple(answer.status for answer in answers),
        objective=np.array([np.nan if a.objective is None else a.objective for a in answers]),
        bound=np.array([answer.bound for answer in answers]),
        gap=np.array([np.nan if answer.gap is None else answer.gap for answer in answers]),
        time=times,
        method=tuple(r.method for r in results),
        winner=tuple(r.winner for r in results),
        tried=np.array([r.tried for r in results], np.int64),
        name=loaded.name,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        tolerance=loaded.spec.solver.tolerance,
        timings={"solve": float(times.sum()), "worst_row": float(times.max())},
        solvers=dict(Counter(answer.solver for answer in answers)),
        sizes={key: value for key, value in counts.items() if key != "by_block"},
    )


def _count_choices(problem: Problem) -> int:
    """Return the number of choices of a problem."""
    return int(problem.program.counts()["choices"])
