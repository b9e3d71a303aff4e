"""`climbplan doctor`: which solvers and libraries are here, and what each is for."""

from __future__ import annotations

import platform
import sys
from typing import Annotated, Any

import typer

from climbplan import __version__
from climbplan.cli.console import print_json, print_result
from climbplan.errors import ExitCode


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List solvers and libraries with versions, what each is used for, and what is missing.

    Exit code 2 if something required is missing or known to give wrong answers.
    """
    from climbplan.cli.dependencies import examine

    findings = examine()
    ready = all(finding.usable or not finding.required for finding in findings)
    solvers = _solvers() if ready else []  # describing them needs what is required
    if as_json:
        dependencies: list[dict[str, Any]] = [finding.as_dict() for finding in findings]
        print_json(
            {
                "climbplan": __version__,
                "python": platform.python_version(),
                "platform": platform.platform(),
                "ready": ready,
                "parts": dependencies,
                "solvers": solvers,
            }
        )
    else:
        print_result(f"climbplan {__version__}, Python {platform.python_version()}")
        print_result(f"{sys.executable}, {platform.platform()}")
        print_result("")
        rows = [("", "version", "state", "used for")]
        rows += [(f.name, f.version or "-", f.state, f.purpose) for f in findings]
        widths = [max(len(row[column]) for row in rows) for column in range(3)]
        for row in rows:
            cells = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
            print_result("  ".join([*cells, row[3]]).rstrip())
        if solvers:
            _print_solvers(solvers)
        for finding in findings:
            if finding.advice:
                print_result(f"{finding.name}: {finding.advice}")
        print_result("everything required is here" if ready else "not ready, see above")
    if not ready:
        raise typer.Exit(ExitCode.USAGE)


def _solvers() -> list[dict[str, Any]]:
    """Every solver of stated programs: what it holds and whether it proves anything."""
    from climbplan.solvers.registry import BACKENDS

    return [
        {
            "name": backend.name,
            "available": backend.available,
            "version": backend.version,
            "holds": sorted(backend.accepts),
            "proves": backend.proves,
            "purpose": backend.purpose,
        }
        for backend in BACKENDS.values()
    ]


def _print_solvers(solvers: list[dict[str, Any]]) -> None:
    """A table; all of them also hold rows and a convex quadratic cost."""
    rows = [("solvers of stated programs", "state", "answers", "holds beside rows", "used for")]
    for solver in solvers:
        holds = ", ".join(solver["holds"]) if len(solver["holds"]) < 5 else "everything"
        rows.append(
            (
                solver["name"],
                "present" if solver["available"] else "missing",
                "proved" if solver["proves"] else "local",
                holds or "-",
                solver["purpose"],
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    print_result("")
    for row in rows:
        cells = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        print_result("  ".join([*cells, row[4]]).rstrip())
    print_result("")
