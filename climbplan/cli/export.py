"""`climbplan export`: a plan as CSV for a robot or another simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import print_result, standard_output
from climbplan.cli.options import Force, Plan, Quiet, Verbose
from climbplan.errors import UsageError


def export(
    plan: Plan,
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File, or - for standard output [default: beside the plan].",
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Write a plan as CSV and print the file's path.

    Of a climb its trajectory (trajectory.csv), of a bookshelf plan the places of all books
    (placements.csv), of a walk its samples (walk.csv).
    """
    path = find_plan(plan)
    from climbplan.api.kinds import plan_kind
    from climbplan.cli.unsound import warn_of_failure

    kind = plan_kind(path)
    warn_of_failure(kind, path)
    if out == "-":
        with standard_output() as stream:
            kind.export_csv(path, stream)
        return
    target = Path(out) if out is not None else path.parent / kind.csv_name
    if target.exists() and not force:
        raise UsageError(f"{target}: already exists; --force replaces it")
    if not target.absolute().parent.is_dir():
        raise UsageError(f"{target}: no such directory {str(target.parent)!r}")
    kind.export_csv(path, target)
    print_result(str(target))
