"""`climbplan validate`: all mistakes of specs, without planning anything."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import typer

from climbplan.cli.console import print_error, print_json, print_result, warn
from climbplan.cli.options import Json, Quiet, Set, Verbose
from climbplan.errors import ExitCode


def validate(
    specs: Annotated[
        list[str], typer.Argument(metavar="SPEC...", help="Spec files, or - for standard input.")
    ],
    assignments: Set = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Check specs of any kind and list every mistake with its file, line and key.

    Exit code 2 if there is one.
    """
    from climbplan.api.validating import check_spec
    from climbplan.errors import SpecError
    from climbplan.schema.loading import load_spec

    results: list[dict[str, Any]] = []
    for spec in specs:
        try:
            loaded = load_spec(spec, assignments or ())
            valid = check_spec(loaded)
        except SpecError as error:
            mistakes = [dataclasses.asdict(mistake) for mistake in error.mistakes]
            results.append({"spec": spec, "valid": False, "mistakes": mistakes})
            if not as_json:
                print_error(error)
        else:
            result = {"spec": spec, "valid": True, "kind": valid.kind, "mistakes": []}
            results.append({**result, "warnings": list(valid.warnings)})
            for line in valid.warnings:
                warn(f"{spec}: {line}")
            if not as_json:
                print_result(f"{spec}: ok ({valid.kind})")
    if as_json:
        print_json({"specs": results})
    if not all(result["valid"] for result in results):
        raise typer.Exit(ExitCode.USAGE)
