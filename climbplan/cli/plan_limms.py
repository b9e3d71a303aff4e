"""`climbplan plan-limms`: several reconfigurable modules deliver a box."""

from __future__ import annotations

import typer

from climbplan.cli.console import Invocation
from climbplan.cli.options import (
    Force,
    Json,
    Method,
    Out,
    Quiet,
    Seed,
    Set,
    Spec,
    TimeLimit,
    Verbose,
)
from climbplan.cli.quick import NoReport, QuickModules, quick_overrides


def plan_limms(
    context: typer.Context,
    spec: Spec,
    *,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    time_limit: TimeLimit = None,
    method: Method = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickModules = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan how modules bring a box to its goal: who latches where and when, motion and forces.

    Prints the path of the plan file. Its directory also holds report.json, and unless --no-report
    report.html and figures/. Exit code 3 if it is proved that no plan exists, 4 if none was
    found (the message says what rules each behaviour out, or what limit was reached), 5 if the plan
    fails its verification.
    """
    from climbplan.cli.plan_run import plan_run
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.limms.schema.loading import load_limms

    session = context.ensure_object(Invocation)
    overrides = quick_overrides("limms", quick)
    overrides += spec_overrides(assignments, seed, time_limit, method)
    loaded = load_limms(spec, overrides)
    with plan_run(session, loaded, out, force, report=not (no_report or quick)) as run:
        run.make(loaded)
    run.hand_over(as_json)
