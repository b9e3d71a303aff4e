"""`climbplan fit-strategy`: from solved problems to a trained strategy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Set, Spec, Verbose
from climbplan.cli.solve_problem import ProblemName, load_problem, run_user_code
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.cli.progress import StageProgress
    from climbplan.learning.fit_run import TrainingData
    from climbplan.learning.model_file import ModelFile
    from climbplan.schema.learning.strategy_loading import LoadedStrategy

MODEL_FILE = "model.h5"

StrategyModelName = Annotated[
    str | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Model: knn, forest, boosting, network or reduce; sets `model.kind`.",
    ),
]


def fit_strategy(
    context: typer.Context,
    spec: Spec,
    *,
    problem: ProblemName = None,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    method: StrategyModelName = None,
    compare: Annotated[
        int,
        typer.Option(
            "--compare",
            metavar="N",
            min=0,
            max=1000,
            help="Number of new problems that the strategy and the default method solve one after "
            "the other, to say which to use; with --problem.",
        ),
    ] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Learn from solved problems which integers to try first.

    SPEC (kind: strategy) names datasets or plan files and the model: knn, forest, boosting,
    network or reduce (--method sets it). Without --problem they are bookshelf scenes. Prints the
    path of the model file, which holds plain arrays; `solve-bookshelf` and `solve` take it as
    solver.model.file. Its directory also holds report.json, report.html and figures/.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.spec_options import key_overrides
    from climbplan.schema.learning.strategy_loading import load_strategy

    session = context.ensure_object(Invocation)
    overrides = key_overrides(
        assignments, ("seed", "--seed", seed), ("model.kind", "--method", method)
    )
    loaded = load_strategy(spec, overrides)
    if compare and problem is None:
        raise UsageError("--compare draws new problems: expected --problem with it")
    if problem is None and loaded.spec.problem is not None:
        raise UsageError(
            f"a spec alone imports no code: name the statement with --problem {loaded.spec.problem}"
        )
    target = out if out is not None else Path("outputs", loaded.name)
    with run_user_code(session), OutputDirectory(target, force=force) as directory:
        stored = _train_and_write(session, problem, loaded, compare, directory.path)
        directory.publish()
    if as_json:
        from climbplan.reports.fits.strategy_report import build_report

        print_json({**build_report(stored), "file": str(target / MODEL_FILE)})
    else:
        print_result(str(target / MODEL_FILE))


def _train_and_write(
    session: Invocation, problem: str | None, loaded: LoadedStrategy, compare: int, directory: Path
) -> ModelFile:
    """Train a model, compare it if asked to, and write its file and report into a directory."""
    from climbplan.cli.progress import StageProgress
    from climbplan.learning.fit_run import (
        build_fit_options,
        build_model_file,
        train,
        write_verified,
    )
    from climbplan.reports.fits.strategy_report import write_report

    with StageProgress(session) as progress:
        data = _data(problem, loaded, progress)
        options = build_fit_options(loaded.spec)
        trained = train(data, options, loaded.spec.data.held_out, progress.report)
        stored = build_model_file(trained, loaded, data)
        stored = write_verified(stored, directory / MODEL_FILE)
        if compare and problem is not None:
            stored = _compare(problem, stored, compare, directory / MODEL_FILE, progress)
        progress.report("report", 0.9)
        for line in _summary(stored):
            session.note(line)
        write_report(stored, data.columns, directory)
    return stored


def _compare(
    problem: str, stored: ModelFile, count: int, path: Path, progress: StageProgress
) -> ModelFile:
    """Compare a model with the default method and write the outcome into its file."""
    from climbplan.api.strategy_comparison import compare_strategy
    from climbplan.learning.fit_run import write_verified

    comparison = compare_strategy(
        load_problem(problem),
        stored.model,
        count,
        seed=stored.seed,
        report=lambda fraction: progress.report("compare", fraction),
    )
    fit = {**stored.fit, "comparison": comparison.as_dict()}
    return write_verified(replace(stored, fit=fit), path)


def _data(problem: str | None, loaded: LoadedStrategy, progress: StageProgress) -> TrainingData:
    progress.report("read", 0.0)
    if problem is None:
        from climbplan.bookshelf.methods.training import collect_shelf_data

        return collect_shelf_data(loaded, progress.report)
    from climbplan.methods.solved import read_training_data

    return read_training_data(load_problem(problem), loaded)


def _summary(stored: ModelFile) -> list[str]:
    """Format the lines of a run in the columns that all commands use."""
    fit = stored.fit
    counts = f"{fit['groups']} problems, {fit['rows']} rows, {fit['strategies']} strategies"
    if "clusters" in fit:
        counts += f", {fit['clusters']} clusters"
    lines = [f"{stored.name}   {stored.model.library.frame.name}: {counts}"]
    kind = stored.model.kind
    lines.append(f"{kind:<9} {'trained':<9} {stored.timings['train']:.2f} s")
    if "evaluation" in fit:
        evaluation = fit["evaluation"]
        within = evaluation["within_first"]
        shares = ", ".join(f"{k}: {100 * within[k]:.0f} %" for k in ("1", "5", "10", "50"))
        accuracy = f"{evaluation['problems']} rows held out, right one among the first {shares}"
        lines.append(f"{'measure':<9} {'':<9} {stored.timings['measure']:.2f} s   {accuracy}")
    if "comparison" in fit:
        seconds = {
            key: f"{fit['comparison'][f'{key}_seconds']:.2g} s"
            for key in ("default", "integers_first", "strategy")
        }
        lines.append(
            f"{'compare':<9} {'':<9} default {seconds['default']}, with learned integers first "
            f"{seconds['integers_first']}, strategy alone {seconds['strategy']} (medians)"
        )
        lines.append(f"{'verdict':<9} {fit['comparison']['verdict']}")
    return lines
