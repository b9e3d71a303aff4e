"""What all benchmarks share: their options, how a run prints its tables, and what it writes."""

from __future__ import annotations

import inspect
import io
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from benchmarks.record import describe_start, make_record
from climbplan.cli.console import Invocation, plain_messages, print_error, say, standard_output
from climbplan.cli.environment import prepare_environment
from climbplan.cli.options import Force, Quiet, Verbose
from climbplan.cli.output_directory import OutputDirectory
from climbplan.cli.progress import StageProgress
from climbplan.errors import ClimbplanError, UsageError
from climbplan.progress import Progress

prepare_environment()  # before NumPy is loaded

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed.")]
Quick = Annotated[bool, typer.Option("--quick", help="Smaller instances, fewer runs.")]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Also write the results as JSON."),
]
Directory = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="DIR", help="Also write bench.txt, bench.json and plots."),
]
Results = Annotated[  # of benchmarks that take hours
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Keep results there; a later run continues with them."
    ),
]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", metavar="N", min=1, help="Workers; counts do not depend on them."),
]
_KEYWORD = inspect.Parameter.KEYWORD_ONLY
# Annotation and default by name: of all benchmarks, and of those that write files
_SHARED: dict[str, tuple[Any, Any]] = {
    "quick": (Quick, False),
    "json_file": (JsonFile, None),
    "quiet": (Quiet, False),
    "verbose": (Verbose, False),
}
_FILES: dict[str, tuple[Any, Any]] = {"out": (Directory, None), "force": (Force, False)}


@dataclass(frozen=True)
class Run:
    """One run of a benchmark: how much it measures, and where its results go."""

    quick: bool
    stream: TextIO  # tables, each line as soon as it is known
    report: Progress  # takes a stage and the fraction of it that is done
    directory: Path | None  # files beside bench.txt and bench.json; None without --out


def number_option(flag: str, description: str, minimum: float = 1) -> Any:
    """Return the Typer option of a number."""
    return typer.Option(flag, metavar="N", min=minimum, help=description)


def name_option(flag: str, metavar: str, description: str) -> Any:
    """Return the Typer option of a name, a list of names or a file."""
    return typer.Option(flag, metavar=metavar, help=description)


def choose_options(quick_values: Mapping[str, Any], run: Run, **options: Any) -> dict[str, Any]:
    """Return the options that are not None, completed by those of a quick run."""
    defaults = quick_values if run.quick else {}
    return {**defaults, **{key: value for key, value in options.items() if value is not None}}


def benchmark(
    *, writes_files: bool = False
) -> Callable[[Callable[..., Mapping[str, Any] | None]], Callable[..., None]]:
    """Make a subcommand of a function `measure(run, **options)`, whose first line is its help.

    The subcommand has the options of the function and those that all benchmarks share. The
    function prints tables to `run.stream` and may return results for the JSON record.

    Args:
        writes_files: The subcommand has --out and --force for a directory of files.
    """

    def register(measure: Callable[..., Mapping[str, Any] | None]) -> Callable[..., None]:
        def command(context: typer.Context, **options: Any) -> None:
            shared = {name: options.pop(name) for name in added}
            _run_benchmark(context, measure, options, shared)

        added = {**(_FILES if writes_files else {}), **_SHARED}
        own = list(inspect.signature(measure, eval_str=True).parameters.values())[1:]
        parameters = [inspect.Parameter("context", _KEYWORD, annotation=typer.Context)]
        parameters += [parameter.replace(kind=_KEYWORD) for parameter in own]
        for name, (annotation, default) in added.items():
            parameters.append(
                inspect.Parameter(name, _KEYWORD, default=default, annotation=annotation)
            )
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in parameters}
        command.__doc__ = measure.__doc__
        app.command(measure.__name__)(command)
        return command

    return register


def _run_benchmark(
    context: typer.Context,
    measure: Callable[..., Mapping[str, Any] | None],
    options: Mapping[str, Any],
    shared: Mapping[str, Any],
) -> None:
    """Print the tables and write the files; an error that is no bug becomes an exit code."""
    session = context.ensure_object(Invocation)
    name = context.command.name or ""
    session.note(f"{name}: {context.command.get_short_help_str(limit=120)}")
    quick, json_file, out = shared["quick"], shared["json_file"], shared.get("out")
    recorded = {key: value for key, value in options.items() if value is not None}
    try:
        if json_file is not None and not json_file.absolute().parent.is_dir():
            raise UsageError(f"{json_file}: no such directory {str(json_file.parent)!r}")
        if json_file is not None and json_file.is_dir():
            raise UsageError(f"{json_file}: a directory, expected the name of a file")
        start = describe_start()
        with ExitStack() as stack:
            stack.enter_context(plain_messages(session))
            output = None
            if out is not None:
                output = stack.enter_context(OutputDirectory(out, shared["force"]))
            stream = _Copied(stack.enter_context(standard_output()))
            progress = stack.enter_context(StageProgress(session))
            run = Run(quick, stream, progress.report, None if output is None else output.path)
            results = measure(run, **options)
            if output is not None:
                (output.path / "bench.txt").write_text(stream.text, encoding="utf-8")
            given = {"quick": quick, **recorded}
            record = make_record(start, name, given, results or {}, stream.text)
            text = json.dumps(record, indent=1, allow_nan=False) + "\n"
            if output is not None:
                (output.path / "bench.json").write_text(text, encoding="utf-8")
                output.publish()
            if json_file is not None:
                json_file.write_text(text, encoding="utf-8")
    except ClimbplanError as error:
        print_error(error)
        raise typer.Exit(error.exit_code) from None
    except OSError as error:
        say(f"error: {error}")
        raise typer.Exit(UsageError.exit_code) from None


class _Copied(io.TextIOBase, TextIO):
    """A stream that shows text as it comes and keeps a copy."""

    def __init__(self, shown: TextIO) -> None:
        self._shown, self.text = shown, ""

    def write(self, text: str) -> int:
        """Show the text and keep it."""
        self.text += text
        return self._shown.write(text)

    def flush(self) -> None:
        """Show what was written."""
        self._shown.flush()
