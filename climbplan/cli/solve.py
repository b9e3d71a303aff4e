"""`climbplan solve`: a problem of one's own, by any method."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.api.plan_path import PLAN_FILE
from climbplan.cli.console import Invocation, print_json, print_result, warn
from climbplan.cli.options import (
    Force,
    Json,
    Method,
    Out,
    Quiet,
    SaveModel,
    Seed,
    Set,
    Solver,
    Spec,
    TimeLimit,
    Verbose,
    takes_options,
)
from climbplan.cli.solve_problem import ProblemName, load_problem, run_user_code
from climbplan.cli.verify_line import format_verification
from climbplan.errors import ExitCode, Infeasible, LimitReached, UsageError

if TYPE_CHECKING:
    from climbplan.methods.run import SolvedRows
    from climbplan.program.problem import Problem
    from climbplan.schema.overrides import Override
    from climbplan.schema.program.loading import LoadedProgram
    from climbplan.store.program_plan import ProgramPlan
    from climbplan.verification.verification import Verification


_SEQUENCE = ("auto", "branch-and-bound", "benders")  # methods that rows of a sequence may name


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """Spec and options of `climbplan solve` as they are given."""

    spec: Spec
    problem: ProblemName = None
    out: Out = None
    assignments: Set = None
    seed: Seed = None
    time_limit: TimeLimit = None
    method: Method = None
    solver: Solver = None
    save_model: SaveModel = None
    as_json: Json = False
    quiet: Quiet = False
    verbose: Verbose = False
    force: Force = False
    certificate: Annotated[
        Path | None,
        typer.Option(
            "--certificate",
            metavar="FILE",
            help="File for proofs of the bounds, which `climbplan verify` checks without a solver.",
        ),
    ] = None
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence",
            help="Rows are one problem whose parameters change: each solve starts from the last.",
        ),
    ] = False
    shift: Annotated[
        int,
        typer.Option(
            "--shift",
            metavar="STEPS",
            min=0,
            help="With --sequence: number of steps by which the horizon recedes from row to row.",
        ),
    ] = 0


@takes_options(SolveOptions)
def solve(context: typer.Context, options: SolveOptions) -> None:
    """Solve a problem of your own, stated in Python or in a model file, by any method.

    SPEC (kind: program) has the parameters and the method, --problem names the statement. A model
    file (.mps, .lp, .nl, .qplib) may stand in place of both. Prints the path of the plan file. Exit
    code 3 if the problem is proved infeasible, 4 if a limit was reached without an answer, 5 if an
    answer fails the statement's exact check. Of several rows one answer is enough for a plan; those
    without one are counted in a warning. With --certificate proofs are written also where nothing
    is feasible.
    """
    from climbplan.cli.output_directory import OutputDirectory

    session = context.ensure_object(Invocation)
    loaded, name = _load_spec(options)
    with run_user_code(session):
        statement = load_problem(name)
        _compare(loaded, name, statement)
        if options.save_model is not None:
            _save(statement, loaded, options.save_model)
        target = options.out if options.out is not None else Path("outputs", loaded.name)
        with OutputDirectory(target, force=options.force) as directory:
            from climbplan.reports.program_report import build_report, write_report
            from climbplan.store.program_file import mark_program, write_program
            from climbplan.verification.programs import verify_program

            done = _solve_rows(session, statement, loaded, options)
            begin = time.perf_counter()
            verification = verify_program(done.plan, statement)
            seconds = time.perf_counter() - begin
            plan = mark_program(done.plan, verification.passed)
            for line in _summary(plan, verification, seconds):
                session.note(line)
            write_program(plan, directory.path / PLAN_FILE)
            report = build_report(plan, verification)
            write_report(report, directory.path)
            directory.publish()
    missing = plan.count - int(plan.found.sum())
    if missing:
        warn(f"{missing} of {plan.count} rows have no answer")
    if options.as_json:
        print_json({**report, "plan": str(target / PLAN_FILE)})
    else:
        print_result(str(target / PLAN_FILE))
    if not verification.passed:
        raise typer.Exit(ExitCode.UNVERIFIED)


def _load_spec(options: SolveOptions) -> tuple[LoadedProgram, str]:
    """Load the spec and return it with the name of the statement, MODULE:OBJECT.

    Raises:
        UsageError: options contradict one another or the spec, or --problem is missing.
    """
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.schema.program.loading import load_program
    from climbplan.solvers.model_files import is_model_file

    solvers = options.solver or []
    if len(solvers) > 1:
        raise UsageError("--solver: one solver expected, methods here use one")
    if options.shift and not options.sequence:
        raise UsageError("--shift goes with --sequence")
    overrides = spec_overrides(
        options.assignments,
        options.seed,
        options.time_limit,
        options.method,
        solver=solvers[0] if solvers else None,
    )
    problem = options.problem
    if is_model_file(options.spec):
        if problem is not None:
            raise UsageError(f"{options.spec} states a problem itself: leave --problem out")
        problem, loaded = options.spec, _load_default_spec(options.spec, overrides)
    else:
        loaded = load_program(options.spec, overrides)
    solver = loaded.spec.solver
    if options.sequence and (solver.method not in _SEQUENCE or solver.solver):
        raise UsageError(
            "--sequence: solved by method branch-and-bound or benders, got "
            f"{solver.method!r}; give --method branch-and-bound and no solver"
        )
    if problem is None:
        named = f"; the spec is written for {loaded.spec.problem}" if loaded.spec.problem else ""
        raise UsageError(
            f"a spec alone imports no code: name the statement with --problem MODULE:OBJECT{named}"
        )
    return loaded, problem


def _load_default_spec(model_file: str, overrides: Sequence[str | Override]) -> LoadedProgram:
    """Return the spec of a problem without parameters that is stated by a model file."""
    from climbplan.schema.overrides import apply_overrides
    from climbplan.schema.program.loading import build_program
    from climbplan.schema.source import SourceText
    from climbplan.schema.yaml_source import parse_yaml

    path = Path(model_file)
    text = f"kind: program\nproblem: {json.dumps(path.name)}\n"
    source = SourceText(model_file, path.stem, path.resolve().parent, text)
    return build_program(apply_overrides(parse_yaml(text, model_file), overrides), source)


def _solve_rows(
    session: Invocation, problem: Problem, loaded: LoadedProgram, options: SolveOptions
) -> SolvedRows:
    """Solve all rows and write their certificates.

    Raises:
        Infeasible: every row is proved infeasible.
        LimitReached: no row has a solution.
    """
    from climbplan.cli.progress import StageProgress
    from climbplan.methods.run import solve_spec

    with StageProgress(session) as progress:
        done = solve_spec(
            problem,
            loaded,
            progress.report,
            options.shift if options.sequence else None,
            options.certificate is not None,
        )
    if options.certificate is not None:
        session.note(_write_certificates(problem, done, loaded, options.certificate, options.force))
    _require_solution(problem, done)
    return done


def _compare(loaded: LoadedProgram, name: str, problem: Problem) -> None:
    """Warn if the problem named in the spec is another one; that name is never imported."""
    meant = loaded.spec.problem
    if meant is None or meant in (name, problem.name):
        return
    if Path(meant).name != Path(name).name:  # the same file from another directory
        warn(f"the spec is written for problem {meant!r}, --problem is {name!r}")


def _save(problem: Problem, loaded: LoadedProgram, path: Path) -> None:
    """Write the program of the first row for other solvers."""
    from climbplan.methods.run import generate_thetas
    from climbplan.solvers.model_file import save_model

    save_model(problem.instance(generate_thetas(problem, loaded)[0]), path)


def _write_certificates(
    problem: Problem, done: SolvedRows, loaded: LoadedProgram, path: Path, force: bool
) -> str:
    """Write the certificates of all rows and return a line about them."""
    from climbplan.methods.certified_rows import collect_certified_rows, is_weaker_than_search
    from climbplan.solvers.result import compute_zero_cost
    from climbplan.store.certificate_file import write_certificates

    if path.exists() and not force:
        raise UsageError(f"{path} exists: --force replaces it")
    certified = collect_certified_rows(problem, done, loaded)
    write_certificates(certified, path)
    leaves = sum(len(row.certificate.empty) for row in certified.rows)
    for number, (row, searched) in enumerate(zip(certified.rows, done.plan.bound, strict=True)):
        proved = row.certificate.bound
        zero_cost = compute_zero_cost(row.instance)
        if is_weaker_than_search(proved, searched, loaded.spec.solver.gap, zero_cost):
            warn(
                f"row {number}: the certificate proves a bound of {proved:.9g}, the search has "
                f"{searched:.9g}; `verify` confirms the former alone. Multipliers of its leaves "
                "are as exact as the solver's; a smaller solver.gap splits them further"
            )
    size = 1e-3 * path.stat().st_size
    return f"proofs    {leaves} leaves, {size:.0f} kB in {path}"


def _require_solution(problem: Problem, done: SolvedRows) -> None:
    """Raise an error if no row has a solution, as there is no plan to write then.

    Raises:
        Infeasible: every row is proved infeasible.
        LimitReached: a limit was hit first.
    """
    plan = done.plan
    if plan.found.any():
        return
    what = f"problem {problem.name!r}" + (f", all {plan.count} rows" if plan.count > 1 else "")
    last = done.rows[0].result
    if plan.overall == "infeasible":
        from climbplan.methods.conflicts import find_conflicting_blocks

        theta = problem.split(plan.parameters[0])
        conflicts = find_conflicting_blocks(problem, theta)
        raise Infeasible(f"{what}: proved infeasible by {last.solver}", conflicts, stage="solve")
    log = f" ({last.log[-1]})" if last.log else ""
    raise LimitReached(f"{what}: no answer by method {done.rows[0].method!r}{log}", stage="solve")


def _summary(plan: ProgramPlan, verification: Verification, seconds: float) -> list[str]:
    """The lines of a run, in the columns that all commands use."""
    size = plan.sizes
    head = (
        f"{plan.problem}   {plan.count} parameter set{'s' if plan.count > 1 else ''}, "
        f"{size['continuous']} continuous, {size['binary']} binary, {size['products']} products"
    )
    method = plan.method[0]
    if plan.count == 1:
        bound = f", bound {plan.bound[0]:.6g}" if plan.total_bound is not None else ""
        figures = f"cost {plan.objective[0]:.6g}{bound}, {plan.winner[0]}"
    else:
        answered = int(plan.found.sum())
        figures = f"{answered} of {plan.count} answered, {1e3 * plan.time.mean():.1f} ms each"
    return [
        head,
        f"{method:<9} {plan.overall:<9} {plan.timings['solve']:.2f} s   {figures}",
        format_verification(verification, seconds),
    ]
