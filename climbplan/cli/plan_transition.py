"""`climbplan plan-transition`: from the ground to the wall, a verified plan and its report."""

from __future__ import annotations

from typing import Annotated

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
from climbplan.cli.quick import NoReport, QuickTransition, quick_overrides


def plan_transition(
    context: typer.Context,
    spec: Spec,
    *,
    rounds: Annotated[
        int | None,
        typer.Option("--rounds", metavar="N", min=1, help="Number of rounds; sets `task.rounds`."),
    ] = None,
    sequence: Annotated[
        str | None,
        typer.Option(
            "--sequence",
            metavar="SEQUENCE",
            help="Contact sequence: how many limbs move in each round (3-1-2-2), or which "
            "('LF LR RM | RF RR LM').",
        ),
    ] = None,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    time_limit: TimeLimit = None,
    method: Method = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickTransition = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a transition from the ground to the wall: contact sequence, postures, forces.

    Prints the path of the plan file. Its directory also holds report.json, and unless --no-report
    report.html and figures/. --sequence also sets the number of rounds. Exit code 3 if it is
    proved that no plan exists, 4 if none was found (the message says which contacts slip), 5 if the
    plan fails its verification.
    """
    from climbplan.cli.plan_run import plan_run
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.climb.schema.transition_loading import load_transition
    from climbplan.schema.overrides import Override

    session = context.ensure_object(Invocation)
    overrides = quick_overrides("transition", quick)
    overrides += spec_overrides(assignments, seed, time_limit, method)
    if rounds is None and sequence is not None:
        rounds = sequence.count("|" if "|" in sequence else "-") + 1
    if rounds is not None:
        overrides.append(Override("task.rounds", str(rounds), f"--rounds {rounds}"))
    if sequence is not None:
        overrides.append(Override("task.sequence", f'"{sequence}"', f"--sequence {sequence}"))
    loaded = load_transition(spec, overrides)
    with plan_run(session, loaded, out, force, report=not (no_report or quick)) as run:
        run.make(loaded)
    run.hand_over(as_json)
