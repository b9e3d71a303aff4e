"""`climbplan verify` of answers to a stated program: the statement is needed for its blocks."""

from __future__ import annotations

from pathlib import Path

import typer

from climbplan.cli.console import Session, print_json, print_result
from climbplan.cli.solve_problem import explained, load_problem
from climbplan.errors import ExitCode, UsageError


def is_program_plan(path: Path) -> bool:
    """Whether the file answers a stated program; others are read by what their format says."""
    from climbplan.plans.plan_format import plan_format
    from climbplan.plans.program_file import FORMAT

    return plan_format(path) == FORMAT


def verify_program_plan(path: Path, name: str | None, as_json: bool, session: Session) -> None:
    """Check a `climbplan/program` file, its blocks by the statement that `name` stands for.

    Raises:
        UsageError: without a statement, after what the file alone allows was checked and printed.
    """
    from climbplan.plans.program_file import read_program
    from climbplan.plans.program_verification import verify_file, verify_program

    plan = read_program(path)
    if name is None:
        verification = verify_file(plan)
    else:
        with explained(session):
            verification = verify_program(plan, load_problem(name))
    if as_json:
        print_json(verification.as_dict())
    else:
        print_result(verification.table())
    if not verification.passed:
        raise typer.Exit(ExitCode.UNVERIFIED)
    if name is None:
        raise UsageError(
            f"{path}: only the file itself was checked (text, bounds, integrality); the rows of "
            f"{plan.problem!r} need its statement: add --problem MODULE:OBJECT"
        )
