"""`climbplan plan-mpc`: from a spec to a verified walk and its report."""

from __future__ import annotations

from typing import Annotated

import typer

from climbplan.cli.console import Invocation
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Set, Spec, TimeLimit, Verbose
from climbplan.cli.quick import NoReport, QuickWalk, quick_overrides


def plan_mpc(
    context: typer.Context,
    spec: Spec,
    *,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    time_limit: TimeLimit = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="Method: gait-search, mpcc, spatial-branch-and-bound or online.",
        ),
    ] = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickWalk = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a legged robot's walk: footsteps, gait, body motion and contact forces together.

    Prints the path of the plan file. Its directory also holds report.json, and unless --no-report
    report.html and figures/. Method `online` walks in closed loop and also leaves library.h5, which
    `library.file` takes. Exit code 4 if a limit was reached without a plan, 5 if the plan fails its
    verification, as when the robot falls.
    """
    from climbplan.cli.plan_run import plan_run
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.walking.schema.loading import load_mpc

    session = context.ensure_object(Invocation)
    overrides = quick_overrides("mpc", quick)
    overrides += spec_overrides(assignments, seed, time_limit, method)
    loaded = load_mpc(spec, overrides)
    with plan_run(session, loaded, out, force, report=not (no_report or quick)) as run:
        run.make(loaded)
    run.hand_over(as_json)
