"""The Typer application: one subcommand a benchmark, and `--list`."""

from __future__ import annotations

from typing import Annotated

import typer

# A family's module registers its subcommands when it is imported.
from benchmarks.commands import (  # noqa: F401
    bookshelf,
    climb,
    limms,
    motions,
    programs,
    robots,
    walking,
)
from benchmarks.running import app

__all__ = ["app"]


def _list_benchmarks(context: typer.Context, value: bool) -> None:
    if not value:
        return
    group = typer.main.get_group(app)
    for name, command in group.commands.items():
        print(f"{name:<12}{command.get_short_help_str(limit=120)}")
    raise typer.Exit


@app.callback()
def _global_options(
    show_list: Annotated[
        bool,
        typer.Option(
            "--list", callback=_list_benchmarks, is_eager=True, help="List the benchmarks."
        ),
    ] = False,
) -> None:
    """Compare the planners with named alternatives on the same instances."""
