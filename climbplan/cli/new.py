"""`climbplan new`: a commented, runnable example spec to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Session, print_result
from climbplan.cli.options import Force, Quiet, Verbose
from climbplan.errors import UsageError


def new(
    context: typer.Context,
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="Kind: climb, transition, bookshelf, mpc, limms, program, dataset, strategy, "
            "robot, module.",
        ),
    ],
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where to write it [default: here].")
    ] = Path(),
    example: Annotated[
        str | None,
        typer.Option(
            "--example",
            metavar="NAME",
            help="Another example: climb_tube, or robot_walker for a robot from a URDF.",
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Write a commented example spec that runs as it is, and print its path."""
    from climbplan.plans.atomic_file import written_aside
    from climbplan.spec.examples import (
        ABOUT,
        FIRST_EXAMPLE,
        example_data,
        example_names,
        example_text,
    )

    if kind not in FIRST_EXAMPLE:
        raise UsageError(f"no spec kind {kind!r}, known are {', '.join(FIRST_EXAMPLE)}")
    name = example or FIRST_EXAMPLE[kind]
    if example is not None and example not in example_names(kind):
        known = ", ".join(example_names(kind))
        raise UsageError(f"no example {example!r} of kind {kind!r}, there are {known}")
    text = example_text(name)
    target = directory / f"{name}.yaml"
    content = {target: text.encode()}
    content |= {directory / data: value for data, value in example_data(name).items()}
    for path in content:
        if path.exists() and not force:
            raise UsageError(f"{path}: already exists; --force replaces it")
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{directory}: cannot be created: {error.strerror}") from error
    for path, value in content.items():
        with written_aside(path) as aside:
            aside.write_bytes(value)
    others = [f"{o} ({ABOUT[o]})" if o in ABOUT else o for o in example_names(kind) if o != name]
    if others:
        listed = ", ".join(others)
        context.ensure_object(Session).note(f"other examples (--example NAME): {listed}")
    print_result(str(target))
