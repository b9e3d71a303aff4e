"""`climbplan verify`: every constraint re-checked from the plan file alone."""

from __future__ import annotations

from typing import Annotated

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, warn
from climbplan.cli.options import Json, Plan, Quiet, Set, Verbose
from climbplan.cli.solve_problem import ProblemName
from climbplan.errors import UsageError

UserSpec = Annotated[
    str | None,
    typer.Option(
        "--spec",
        metavar="SPEC",
        help="Spec to verify against, in place of the one that the plan carries.",
    ),
]


def verify(
    context: typer.Context,
    plan: Plan,
    *,
    problem: ProblemName = None,
    spec: UserSpec = None,
    assignments: Set = None,
    worlds: Annotated[
        bool,
        typer.Option(
            "--worlds",
            help="Count falls again in the worlds that the plan names, and compare.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Re-check every constraint of a plan from its file alone.

    Prints the level of the plan (fine, look at this, do not use), what it is verified in, the spec
    it was verified against (hash first), and the worst residual of each check with its limit. Exit
    code 5 if one is exceeded or data are implausible.

    With --worlds falls are counted again in the worlds that the plan names by seed. With --spec the
    plan is verified against your own spec with your --set: a plan whose stored spec requires less
    fails, and keys that differ are named. Plans of `climbplan solve`, and datasets of such
    problems, also need the statement that they answer: --problem. A file of `solve --certificate`
    is checked leaf by leaf; with --problem its numbers are compared with the statement's.
    """
    path = find_plan(plan)
    if assignments and spec is None:
        raise UsageError("--set: expected --spec SPEC with it, whose keys it changes")
    if worlds:
        from climbplan.api.recounting import recount_worlds, require_climb

        require_climb(path)
    user_spec = None
    if spec is not None:
        from climbplan.api.holding import load_spec_to_verify

        user_spec = load_spec_to_verify(path, spec, assignments)
    from climbplan.api.kinds import identify_kind
    from climbplan.cli.solve_verify import tell, verify_program_file

    if verify_program_file(path, problem, as_json, context.ensure_object(Invocation), user_spec):
        return
    verification = identify_kind(path).verify(path, user_spec)
    if worlds:
        verification = recount_worlds(path, verification)
    if user_spec is None:
        from climbplan.verification.verification import find_stored_differences

        for difference in find_stored_differences(path, verification):
            warn(difference)
    tell(verification, as_json)
