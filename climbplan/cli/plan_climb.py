"""`climbplan plan-climb`: from a spec to a verified plan and its report."""

from __future__ import annotations

import typer

from climbplan.cli.console import Invocation
from climbplan.cli.model_path import check_model_path
from climbplan.cli.options import (
    Force,
    Jobs,
    Json,
    Method,
    Out,
    Quiet,
    SaveModel,
    Seed,
    Set,
    Solver,
    Spec,
    TimeLimit,
    Verbose,
)
from climbplan.cli.quick import NoReport, QuickClimb, quick_overrides


def plan_climb(
    context: typer.Context,
    spec: Spec,
    *,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    time_limit: TimeLimit = None,
    method: Method = None,
    solver: Solver = None,
    save_model: SaveModel = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickClimb = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a climb: postures, contact forces, torques.

    Prints the path of the plan file. Its directory also holds report.json, and unless --no-report
    report.html and figures/. Exit code 3 if it is proved that no plan exists, 4 if none was found
    (the message says what was tried and what would help), 5 if the plan fails its verification
    or data are implausible.
    """
    from climbplan.cli.plan_run import plan_run
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.climb.schema.loading import load_climb

    session = context.ensure_object(Invocation)
    overrides = quick_overrides("climb", quick)
    overrides += spec_overrides(assignments, seed, time_limit, method, solver)
    loaded = load_climb(spec, overrides)
    check_model_path(save_model)
    with plan_run(session, loaded, out, force, report=not (no_report or quick)) as run:
        run.make(loaded, jobs, save_model)
    run.hand_over(as_json)
