"""`climbplan gen-data`: many problems sampled and solved, into one dataset."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.api.plan_path import DATASET_FILE
from climbplan.cli.console import Invocation, print_json, print_result, warn
from climbplan.cli.dataset_progress import DatasetProgress
from climbplan.cli.options import (
    Force,
    Json,
    Out,
    Quiet,
    Seed,
    Set,
    Spec,
    Verbose,
    takes_options,
)
from climbplan.cli.solve_problem import ProblemName, load_problem, run_user_code
from climbplan.cli.verify_line import format_verification
from climbplan.errors import ExitCode, PlanFileError, UsageError

if TYPE_CHECKING:
    from climbplan.datasets.generate import Generated
    from climbplan.datasets.recipe import Recipe
    from climbplan.datasets.schema.loading import LoadedDataset
    from climbplan.program.problem import Problem
    from climbplan.verification.verification import Verification


@dataclass(frozen=True, kw_only=True)
class GenDataOptions:
    """Spec and options of `climbplan gen-data` as they are given."""

    spec: Spec
    problem: ProblemName = None
    out: Out = None
    assignments: Set = None
    seed: Seed = None
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", metavar="N", min=1, help="Number of worker processes.")
    ] = 1
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Dask cluster whose workers are used in place of --jobs: tcp://HOST:PORT, or "
            "local-cluster:N.",
        ),
    ] = None
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="SECONDS", help="Time limit of one row [s]."),
    ] = None
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Method; sets `problem.solver.method`."),
    ] = None
    resume: Annotated[bool, typer.Option("--resume", help="Continue a run that was stopped.")] = (
        False
    )
    as_json: Json = False
    quiet: Quiet = False
    verbose: Verbose = False
    force: Force = False


@takes_options(GenDataOptions)
def gen_data(context: typer.Context, options: GenDataOptions) -> None:
    """Sample problems of one kind, solve them all, and keep every outcome as a row.

    Prints the path of dataset.h5. The same rows come about with any number of workers, on this
    machine or a cluster. Rows without an answer are kept with their reason. A run that is stopped
    keeps its rows: --resume goes on with them. A problem of your own is named by --problem. Exit
    code 4 if no row has an answer, 5 if an answer fails its check.
    """
    from climbplan.cli.output_directory import OutputDirectory

    session = context.ensure_object(Invocation)
    loaded = _load_spec(options)
    target = options.out if options.out is not None else Path("outputs", loaded.name)
    if options.resume and not options.force and _is_complete(target, loaded):
        session.note(f"{target}: complete already")
        if options.as_json:
            print_json({"plan": str(target / DATASET_FILE), "complete": True})
        else:
            print_result(str(target / DATASET_FILE))
        return
    with run_user_code(session), OutputDirectory(target, force=options.force) as directory:
        # Compiled functions and solvers take a second to import: not before the paths are good.
        from climbplan.datasets.generate import RunOptions, generate_rows
        from climbplan.datasets.pages.report import build_report_values, write_report
        from climbplan.store.dataset_file import read_dataset_file

        statement = _load_statement(loaded, options.problem)
        recipe = _build_recipe(loaded, options.problem)
        jobs = options.jobs
        run_options = RunOptions(target, jobs, options.scheduler, options.resume, options.force)
        workers = options.scheduler or f"{jobs} worker{'s' * (jobs > 1)}"
        session.note(_format_head(loaded, workers))
        files = _list_files(loaded, options.problem)
        with DatasetProgress(session) as progress:
            run = generate_rows(loaded, recipe, files, run_options, progress.report, session.note)
            with run as generated_rows:
                progress.stop()
                path = directory.path / DATASET_FILE
                verification = _write_rows(session, generated_rows, path, statement)
                data = read_dataset_file(path)
                write_report(path, directory.path, verification)
                directory.publish()
    if options.as_json:
        print_json({**build_report_values(data, verification), "plan": str(target / DATASET_FILE)})
    else:
        print_result(str(target / DATASET_FILE))
    if not verification.passed:
        raise typer.Exit(ExitCode.UNVERIFIED)
    if not data.feasible.any():
        raise typer.Exit(ExitCode.LIMIT)


def _load_spec(options: GenDataOptions) -> LoadedDataset:
    from climbplan.cli.spec_options import key_overrides
    from climbplan.datasets.schema.loading import load_dataset

    overrides = key_overrides(
        options.assignments,
        ("seed", "--seed", options.seed),
        ("problem.solver.time_limit", "--time-limit", options.time_limit),
        ("problem.solver.method", "--method", options.method),
    )
    return load_dataset(options.spec, overrides)


def _write_rows(
    session: Invocation, generated_rows: Generated, path: Path, statement: Problem | None
) -> Verification:
    """Write the rows, then read, verify and mark the file."""
    from climbplan.datasets.check.verification import verify_and_mark
    from climbplan.store.dataset_file import write_dataset_file

    session.note(_format_summary(generated_rows))
    generated_rows.copy_files(path.parent)
    write_dataset_file(generated_rows.data, path)
    begin = time.perf_counter()
    verification = verify_and_mark(path, statement)
    session.note(format_verification(verification, time.perf_counter() - begin))
    return verification


def _is_complete(target: Path, loaded: LoadedDataset) -> bool:
    """Return whether the output directory already holds the dataset of this spec."""
    from climbplan.store.dataset_file import read_dataset_file

    path = target / DATASET_FILE
    try:
        return path.is_file() and read_dataset_file(path).spec_sha256 == loaded.sha256
    except PlanFileError:
        return False


def _load_statement(loaded: LoadedDataset, name: str | None) -> Problem | None:
    """Load the problem that the command line names; a spec alone imports no code."""
    problem = loaded.spec.problem
    if problem.kind != "program":
        if name is not None:
            raise UsageError("--problem goes with problem.kind `program` only")
        return None
    if name is None:
        named = f"; the spec is written for {problem.problem}" if problem.problem else ""
        raise UsageError(
            f"a spec alone imports no code: name the statement with --problem MODULE:OBJECT{named}"
        )
    stated = load_problem(name)
    meant = problem.problem
    if meant is not None and Path(meant).name not in (Path(name).name, stated.name):
        warn(f"the spec is written for problem {meant!r}, --problem is {name!r}")
    return stated


def _build_recipe(loaded: LoadedDataset, name: str | None) -> Recipe:
    """Build the recipe for the workers; files have full paths, as workers may start elsewhere."""
    from climbplan.datasets.recipe import Recipe

    spec = loaded.spec
    problem = spec.problem
    directory = loaded.directory.absolute()
    if problem.kind == "bookshelf":
        from climbplan.datasets.shelf_source import build_shelf_source

        source = functools.partial(build_shelf_source, problem, directory, spec.seed)
        return Recipe(source, spec.seed, spec.row_seconds, loaded.sha256)
    if problem.kind == "terrains":
        from climbplan.datasets.terrain_source import build_terrain_source

        terrains = functools.partial(build_terrain_source, problem, directory)
        return Recipe(terrains, spec.seed, spec.row_seconds, loaded.sha256)
    if problem.kind == "mpc":
        from climbplan.datasets.walk_source import build_walk_source

        walks = functools.partial(build_walk_source, problem, directory)
        return Recipe(walks, spec.seed, spec.row_seconds, loaded.sha256)
    if problem.kind == "motions":
        from climbplan.datasets.motion_source import build_motion_source
        from climbplan.datasets.motions.walkers import prepare_walkers

        walkers = prepare_walkers(problem.robots, directory)
        motions = functools.partial(build_motion_source, problem, walkers, directory)
        return Recipe(motions, spec.seed, spec.row_seconds, loaded.sha256)
    from climbplan.datasets.program_source import build_program_source

    load = functools.partial(load_problem, _full(name or ""))
    stated = functools.partial(build_program_source, load, problem, directory)
    return Recipe(stated, spec.seed, spec.row_seconds, loaded.sha256)


def _full(name: str) -> str:
    """Return FILE.py:OBJECT with the full path of the file; other names unchanged."""
    place, _, attribute = name.rpartition(":")
    return f"{Path(place).absolute()}:{attribute}" if place.endswith(".py") else name


def _list_files(loaded: LoadedDataset, name: str | None) -> tuple[Path, ...]:
    """List the files that rows depend on: the statement, and library or model of the method."""
    from climbplan.schema.robots.source import find_robot_files

    files: list[Path] = []
    place = (name or "").rpartition(":")[0]
    if place.endswith(".py"):
        files.append(Path(place).absolute())
    problem = loaded.spec.problem
    if problem.kind == "terrains" or problem.kind == "mpc":
        if Path(problem.robot).suffix in (".yaml", ".yml"):
            files += find_robot_files(problem.robot, loaded.directory.absolute())
        return tuple(files)
    if problem.kind == "motions":
        from climbplan.datasets.motions.scenes import list_scene_files
        from climbplan.datasets.motions.walkers import list_walker_files

        directory = loaded.directory.absolute()
        scene_files = list_scene_files(problem.scenes, directory)
        return (*list_walker_files(problem.robots, directory), *scene_files)
    for source in (problem.solver.library, problem.solver.model):
        if source is not None:
            named = source if isinstance(source, str) else source.file
            files.append(loaded.directory.absolute() / named)
    return tuple(files)


def _format_head(loaded: LoadedDataset, workers: str) -> str:
    spec = loaded.spec
    return (
        f"{loaded.name}   {spec.count} rows, problem {spec.problem.kind}, "
        f"method {spec.problem.solver.method}, seed {spec.seed}, {workers}"
    )


def _format_summary(generated_rows: Generated) -> str:
    data, count = generated_rows.data, generated_rows.count
    ended = ", ".join(f"{number} {status}" for status, number in data.statuses.items())
    resumed = f", {generated_rows.resumed} resumed" if generated_rows.resumed else ""
    rate = f", {count.rate:.3g} rows/s" if count.new else ""
    return f"{'rows':<9} {data.overall:<9} {count.seconds:.2f} s   {ended}{rate}{resumed}"
