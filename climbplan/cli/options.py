"""The options that several commands share, each spelt once."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from climbplan.cli.console import Invocation


def _quiet(context: typer.Context, value: bool) -> bool:
    context.ensure_object(Invocation).quiet = value
    return value


def _verbose(context: typer.Context, value: bool) -> bool:
    context.ensure_object(Invocation).verbose = value
    return value


Spec = Annotated[str, typer.Argument(metavar="SPEC", help="Spec file, or - for standard input.")]
Plan = Annotated[
    Path, typer.Argument(metavar="PLAN", help="Plan file, or the output directory it is in.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Output directory [default: outputs/<spec name>]."
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="KEY=VALUE",
        help="Value for a key of the spec, such as task.rounds=6; repeatable.",
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed", metavar="N", help="Seed of all random numbers [default: the spec's, else 0]."
    ),
]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", metavar="N", min=1, help="Number of parallel workers of a study."),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time-limit",
        metavar="SECONDS",
        help="Time limit of one problem [s]; sets `solver.time_limit`.",
    ),
]
Method = Annotated[
    str | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Method; sets `solver.method`, whose values `climbplan schema KIND` lists.",
    ),
]
Solver = Annotated[
    list[str] | None,
    typer.Option(
        "--solver",
        metavar="NAME",
        help="Solver that the method uses; repeatable where it uses several (postures, forces).",
    ),
]
SaveModel = Annotated[
    Path | None,
    typer.Option(
        "--save-model",
        metavar="FILE",
        help="File for the mathematical program, for other solvers (.lp, .mps, .cip or .nl).",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Result as one JSON object on standard output.")]
Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet", "-q", callback=_quiet, help="No progress and no summary on standard error."
    ),
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        callback=_verbose,
        help="Log on standard error, with tracebacks of internal errors.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]


Options = TypeVar("Options")


def takes_options(
    options: type[Options],
) -> Callable[[Callable[[typer.Context, Options], None]], Callable[..., None]]:
    """Return a decorator that makes the fields of a dataclass a command's arguments and options.

    Typer reads them from the signature of a function. The decorated function has that signature
    and passes all values on as one object, whose order of fields is that of `--help`.

    Args:
        options: Dataclass whose fields are annotated as the parameters of a Typer command.
    """
    hints = get_type_hints(options, include_extras=True)
    fields = inspect.signature(options).parameters.values()
    parameters = [
        inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context),
        *(field.replace(annotation=hints[field.name]) for field in fields),
    ]

    def decorate(run: Callable[[typer.Context, Options], None]) -> Callable[..., None]:
        @wraps(run)
        def command(context: typer.Context, **values: Any) -> None:
            run(context, options(**values))

        vars(command)["__signature__"] = inspect.Signature(parameters)
        return command

    return decorate
