"""`climbplan schema`: JSON Schema of the specs, for editors."""

from __future__ import annotations

from typing import Annotated

import typer

from climbplan.cli.console import print_json


def schema(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help="Kind of spec [default: all kinds].")
    ] = None,
) -> None:
    """Print the JSON Schema of a kind of spec, with the meaning and unit of each key."""
    from climbplan.schema.json_schema import build_all_schemas, json_schema

    print_json(build_all_schemas() if kind is None else json_schema(kind))
