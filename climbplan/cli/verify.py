"""`climbplan verify`: every constraint re-checked from the plan file alone."""

from __future__ import annotations

import typer

from climbplan.cli.console import Session, print_json, print_result
from climbplan.cli.options import Json, Plan, Quiet, Verbose
from climbplan.cli.plan_path import find_plan
from climbplan.cli.solve_problem import ProblemName
from climbplan.errors import ExitCode


def verify(
    context: typer.Context,
    plan: Plan,
    problem: ProblemName = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Re-check every constraint of a plan from its file alone.

    Prints the worst residual of each check and its limit. Exit code 5 if one is exceeded. Plans of
    `climbplan solve`, and datasets of such problems, also need the statement that they answer:
    --problem.
    """
    path = find_plan(plan)
    from climbplan.cli.plan_kinds import plan_kind
    from climbplan.cli.solve_verify import (
        is_program_dataset,
        is_program_plan,
        verify_program_dataset,
        verify_program_plan,
    )

    if is_program_dataset(path):
        verify_program_dataset(path, problem, as_json, context.ensure_object(Session))
        return
    if is_program_plan(path):
        verify_program_plan(path, problem, as_json, context.ensure_object(Session))
        return
    verification = plan_kind(path).verify(path)
    if as_json:
        print_json(verification.as_dict())
    else:
        print_result(verification.table())
    if not verification.passed:
        raise typer.Exit(ExitCode.UNVERIFIED)
