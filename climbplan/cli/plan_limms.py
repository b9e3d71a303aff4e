"""`climbplan plan-limms`: several reconfigurable modules deliver a box."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from climbplan.cli.console import Session, print_json, print_result, warn
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


def plan_limms(
    context: typer.Context,
    spec: Spec,
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
    """Plan how modules bring a box to its goal: who latches where and when, motion and forces.

    Prints the path of the plan file. Its directory also holds report.json, report.html and
    figures/. Exit code 3 if no plan exists (the message says what rules each behaviour out), 4 if a
    limit was reached without one, 5 if the plan fails its verification.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.spec.limms_loading import load_limms

    session = context.ensure_object(Session)
    loaded = load_limms(spec, spec_overrides(assignments, seed, time_limit, method))
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        # CasADi and figures take a second to import: not before all paths are good.
        from climbplan.limms.plan_file import write_limms_plan
        from climbplan.limms.planner import plan_limms as plan
        from climbplan.limms.verification import verify_and_mark
        from climbplan.reports.limms_report import report_dict, write_report

        with StageProgress(session) as progress:
            found = plan(loaded, progress.report)
            progress.report("verify", 0.0)  # ends the planner's bar before lines are printed
            for line in found.summary:
                session.note(line)
            for warning in found.warnings:
                warn(warning)
            plan_file = directory.path / PLAN_FILE
            write_limms_plan(found, plan_file)
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
