"""`climbplan solve-bookshelf`: from a spec to verified placements and their report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation
from climbplan.cli.model_path import check_model_path
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Set, Spec, Verbose
from climbplan.cli.quick import NoReport, QuickShelf, quick_overrides
from climbplan.errors import ExitCode

SceneJobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        min=1,
        help="Number of parallel workers for a file of scenes.",
    ),
]
ShelfMethod = Annotated[
    str | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Method, such as exact; `climbplan schema bookshelf` lists all.",
    ),
]


def solve_bookshelf(
    context: typer.Context,
    spec: Spec,
    *,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    jobs: SceneJobs = 1,
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="SECONDS", help="Time limit of one scene [s]."),
    ] = None,
    method: ShelfMethod = None,
    solver: Annotated[
        str | None,
        typer.Option("--solver", metavar="NAME", help="Solver, for methods that have several."),
    ] = None,
    save_model: Annotated[
        Path | None,
        typer.Option(
            "--save-model",
            metavar="FILE",
            help="File for the first scene's program (.lp, .mps or .cip).",
        ),
    ] = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickShelf = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Insert a book among others with the least movement, in one scene or a file of scenes.

    Prints the path of the plan file. Its directory also holds report.json, and unless --no-report
    report.html and figures/. A path that --set gives starts from the current directory, one in the
    spec from the spec's. Exit code 3 if it is proved that the book cannot be inserted (the message
    says what width is missing), 4 if a limit was reached without a placement, 5 if the plan fails
    its verification. Of a file of scenes these are rows like others: 3 if all scenes are proved
    infeasible, 4 if one or more have no answer.
    """
    from climbplan.bookshelf.schema.loading import load_shelf
    from climbplan.cli.plan_run import plan_run
    from climbplan.cli.spec_options import spec_overrides

    session = context.ensure_object(Invocation)
    overrides = quick_overrides("bookshelf", quick)
    overrides += spec_overrides(assignments, seed, time_limit, method, solver=solver)
    loaded = load_shelf(spec, overrides)
    check_model_path(save_model)
    with plan_run(session, loaded, out, force, report=not (no_report or quick)) as run:
        result = run.make(loaded, jobs, save_model)
    run.hand_over(as_json)
    if result.status == "limit":
        raise typer.Exit(ExitCode.LIMIT)
    if result.status == "infeasible":
        raise typer.Exit(ExitCode.INFEASIBLE)
