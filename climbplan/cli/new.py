"""`climbplan new`: a commented, runnable example spec to start from."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation, print_result
from climbplan.cli.options import Force, Quiet, Verbose, takes_options
from climbplan.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class NewOptions:
    """Kind, directory and options of `climbplan new` as they are given."""

    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="Kind: climb, transition, bookshelf, mpc, limms, program, dataset, strategy, "
            "robot, module.",
        ),
    ]
    directory: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Directory to write into: the current one if left out."),
    ] = Path()
    example: Annotated[
        str | None,
        typer.Option(
            "--example",
            metavar="NAME",
            help="Name of another example, such as climb_tube, or robot_walker for a URDF robot.",
        ),
    ] = None
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            metavar="FILE",
            help="URDF or MJCF file from which a robot is proposed (kind robot), with specs that "
            "plan.",
        ),
    ] = None
    package: Annotated[
        str | None,
        typer.Option(
            "--package",
            metavar="NAME:PART",
            help="Installed Python package and part of the path of a URDF in it, in place of "
            "--urdf.",
        ),
    ] = None
    toes: Annotated[
        str | None,
        typer.Option(
            "--toes",
            metavar="LINKS",
            help="With --urdf or --package: links that the legs end in, separated by commas; two "
            "are flat feet [default: found in the URDF].",
        ),
    ] = None
    quiet: Quiet = False
    verbose: Verbose = False
    force: Force = False


@takes_options(NewOptions)
def new(context: typer.Context, options: NewOptions) -> None:
    """Write a commented example spec that runs as it is, and print its path.

    With --urdf or --package: NAME.yaml, specs of a robot on the ground, between walls, from the
    ground to walls and walking (NAME_ground, _chimney, _wall, _walk; on two flat feet the first
    alone) and the page NAME.html, with legs, toes, postures and stiffness proposed and what is
    assumed marked.
    """
    session = context.ensure_object(Invocation)
    if options.urdf is not None or options.package is not None:
        _write_new_robot(session, options, _parse_toe_links(options.toes))
        return
    if options.toes is not None:
        raise UsageError("--toes is of a robot from a URDF: expected --urdf or --package with it")
    from climbplan.schema.examples import (
        ABOUT,
        FIRST_EXAMPLE,
        list_example_names,
        read_example,
        read_example_data,
    )

    kind, directory = options.kind, options.directory
    if directory.is_file():
        hint = f"; `climbplan new robot --urdf {directory}` proposes a robot" * (kind == "robot")
        raise UsageError(f"{directory}: expected a directory to write into, got a file{hint}")
    if kind not in FIRST_EXAMPLE:
        raise UsageError(f"no spec kind {kind!r}, known are {', '.join(FIRST_EXAMPLE)}")
    name = options.example or FIRST_EXAMPLE[kind]
    if options.example is not None and options.example not in list_example_names(kind):
        names = ", ".join(list_example_names(kind))
        raise UsageError(f"no example {options.example!r} of kind {kind!r}, there are {names}")
    text = read_example(name)
    target = directory / f"{name}.yaml"
    content = {target: text.encode()}
    content |= {directory / data: value for data, value in read_example_data(name).items()}
    _write_all(content, directory, options.force)
    other_examples = [
        f"{o} ({ABOUT[o]})" if o in ABOUT else o for o in list_example_names(kind) if o != name
    ]
    if other_examples:
        session.note(f"other examples (--example NAME): {', '.join(other_examples)}")
    print_result(str(target))


def _parse_toe_links(toes: str | None) -> tuple[str, ...]:
    """Split `--toes` into links; raises UsageError for fewer than two, empty or double names."""
    links = () if toes is None else tuple(link.strip() for link in toes.split(","))
    if toes is not None and (len(links) < 2 or not all(links) or len(set(links)) < len(links)):
        raise UsageError(f"--toes {toes!r}: expected two different links or more, by commas")
    return links


def _write_all(content: dict[Path, bytes], directory: Path, force: bool) -> None:
    """Write all files or none; directories that were created are removed on failure."""
    from climbplan.store.atomic_file import replace_atomically

    _refuse_existing(content, force)
    above = [directory, *directory.parents]
    new_directories = [path for path in above if not path.exists()]
    try:
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{directory}: cannot be created: {error.strerror}") from error
        for path, value in content.items():
            with replace_atomically(path) as temporary:
                temporary.write_bytes(value)
    except BaseException:
        for path in new_directories:  # the innermost first; what holds a file stays
            with suppress(OSError):
                path.rmdir()
        raise


def _refuse_existing(paths: Iterable[Path], force: bool) -> None:
    for path in paths:
        if path.exists() and not force:
            raise UsageError(f"{path}: already exists; --force replaces it")


def _write_new_robot(session: Invocation, options: NewOptions, toes: tuple[str, ...]) -> None:
    """Write the files of a robot from a URDF."""
    if options.kind != "robot":
        raise UsageError(f"--urdf and --package are for `new robot`, not for kind {options.kind!r}")
    sources = {"--urdf": options.urdf, "--package": options.package, "--example": options.example}
    if sum(value is not None for value in sources.values()) > 1:
        raise UsageError("expected one of --urdf, --package and --example")
    from climbplan.api.new_robot import list_file_names, new_robot
    from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf

    path = options.urdf if options.urdf is not None else find_package_urdf(options.package or "")
    directory = options.directory
    _refuse_existing((directory / name for name in list_file_names(path)), options.force)
    robot_files = new_robot(path, directory, session.note, toes)
    content = {directory / name: text.encode() for name, text in robot_files.files.items()}
    _write_all(content, directory, options.force)
    for note in robot_files.notes:
        session.note(note)
    print_result(str(directory / f"{robot_files.name}.yaml"))
