"""`climbplan report`: figures and a self-contained page from a plan file."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Plan, Quiet, Verbose
from climbplan.cli.output_directory import OutputDirectory
from climbplan.errors import UsageError

REPORT_FILES = ("report.json", "report.html", "figures")


def place_report(target: Path, write: Callable[[Path], None], replace: bool) -> None:
    """Let `write` make a report aside, then move its files into `target`.

    Raises:
        UsageError: a report is there and `replace` is not set, or nothing can be written there.
    """
    present = [name for name in REPORT_FILES if (target / name).exists()]
    if present and not replace:
        raise UsageError(f"{target}: already holds {present[0]}; --force replaces it")
    if not target.exists():
        with OutputDirectory(target) as directory:
            write(directory.path)
            directory.publish()
        return
    try:
        temporary = Path(tempfile.mkdtemp(prefix=".report.", dir=target))
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from error
    try:
        write(temporary)
        for entry in temporary.iterdir():
            if entry.is_dir():
                shutil.rmtree(target / entry.name, ignore_errors=True)
            os.replace(entry, target / entry.name)
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


PAGE = "report.html"


def report(
    context: typer.Context,
    plan: Plan,
    *,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Directory [default: beside the plan]."),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also a film (.gif, .webp or .mp4) of what is planned, and a still (.png) beside "
            "it.",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Write report.html, report.json and figures/ of a plan, and print the page's path.

    Beside the plan, an older report is replaced; in a directory of another plan only with
    --force. With --json the report is printed and nothing is written. With --film the film's path
    is printed on a second line.
    """
    path = find_plan(plan)
    from climbplan.api.kinds import identify_kind
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.unsound import warn_of_failure

    kind = identify_kind(path)
    verification = warn_of_failure(kind, path)
    if film is not None:
        _check_film(film, force, as_json)
    if as_json:
        print_json({**kind.build_report(path), "plan": str(path)})
        return
    target = out if out is not None else path.parent
    is_plan_folder = target.resolve() == path.parent.resolve()
    with StageProgress(context.ensure_object(Invocation)) as progress:
        progress.report("report", 0.0)
        place_report(
            target,
            lambda directory: kind.write_report(path, directory, verification),
            force or is_plan_folder,
        )
        if film is not None:
            from climbplan.exports.film import write_film

            badge = verification.badge + (", fragile" if verification.fragile else "")
            write_film(
                kind.read_scene(path), film, badge, lambda part: progress.report("film", part)
            )
    print_result(str(target / PAGE))
    if film is not None:
        print_result(str(film))


def _check_film(film: Path, force: bool, as_json: bool) -> None:
    """Raise an error if no film can be written, before the report is."""
    from climbplan.exports.film import check_film

    if film.exists() and not force:
        raise UsageError(f"{film}: already exists; --force replaces it")
    if as_json:
        raise UsageError("--film: expected no --json with it, which writes no files")
    check_film(film)
