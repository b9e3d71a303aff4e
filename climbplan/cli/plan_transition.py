"""`climbplan plan-transition`: from the ground to the wall, a verified plan and its report."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Session, print_json, print_result, warn
from climbplan.cli.mistakes import placed_mistakes
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
from climbplan.cli.plan_path import PLAN_FILE
from climbplan.cli.verify_line import verify_line
from climbplan.errors import ExitCode


def plan_transition(
    context: typer.Context,
    spec: Spec,
    rounds: Annotated[
        int | None, typer.Option("--rounds", metavar="N", min=1, help="Number of rounds.")
    ] = None,
    sequence: Annotated[
        str | None,
        typer.Option(
            "--sequence",
            metavar="SEQUENCE",
            help="How many limbs move in each round (3-1-2-2), or which ('LF LR RM | RF RR LM').",
        ),
    ] = None,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    time_limit: TimeLimit = None,
    method: Method = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a transition from the ground to the wall: contact sequence, postures, forces.

    Prints the path of the plan file. Its directory also holds report.json, report.html and
    figures/. --sequence also sets the number of rounds. Exit code 3 if no sequence exists on what
    is searched (the message says which contacts slip), 4 if none could be planned to the end, 5 if
    the plan fails its verification.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.spec.overrides import Override
    from climbplan.spec.transition_loading import load_transition

    session = context.ensure_object(Session)
    overrides = spec_overrides(assignments, seed, time_limit, method)
    if rounds is None and sequence is not None:
        rounds = sequence.count("|" if "|" in sequence else "-") + 1
    if rounds is not None:
        overrides.append(Override("task.rounds", str(rounds), f"--rounds {rounds}"))
    if sequence is not None:
        overrides.append(Override("task.sequence", f'"{sequence}"', f"--sequence {sequence}"))
    loaded = load_transition(spec, overrides)
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.plans.climb_file import write_climb
        from climbplan.plans.verification import verify_and_mark
        from climbplan.reports.climb_report import report_dict, write_report
        from climbplan.transition.planner import plan_transition as plan

        with StageProgress(session) as progress:
            with placed_mistakes(loaded):
                found = plan(loaded, report=progress.report)
            plan_file = directory.path / PLAN_FILE
            progress.report("verify", 0.0)  # ends the planner's bar before lines are printed
            for line in found.summary:
                session.note(line)
            for warning in found.warnings:
                warn(warning)
            write_climb(found, plan_file)
            start = time.perf_counter()
            verification = verify_and_mark(plan_file)
            session.note(verify_line(verification, time.perf_counter() - start))
            progress.report("report", 0.0)
            write_report(plan_file, directory.path, verification)
        directory.publish()
    if as_json:
        print_json(report_dict(target / PLAN_FILE))
    else:
        print_result(str(target / PLAN_FILE))
    if not verification.passed:
        raise typer.Exit(ExitCode.UNVERIFIED)
