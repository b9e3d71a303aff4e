"""`climbplan plan-climb`: from a spec to a verified plan and its report."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from climbplan.cli.console import Session, print_json, print_result, warn
from climbplan.cli.mistakes import placed_mistakes
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
from climbplan.cli.plan_path import PLAN_FILE
from climbplan.cli.verify_line import verify_line
from climbplan.errors import ExitCode


def plan_climb(
    context: typer.Context,
    spec: Spec,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    time_limit: TimeLimit = None,
    method: Method = None,
    solver: Solver = None,
    save_model: SaveModel = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a climb: postures, contact forces, torques.

    Prints the path of the plan file. Its directory also holds report.json, report.html and
    figures/. Exit code 3 if the method finds that no plan exists (the message says at which stage
    and why), 4 if a limit was reached without one, 5 if the plan fails its verification.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.spec.loading import load_climb

    session = context.ensure_object(Session)
    overrides = spec_overrides(assignments, seed, time_limit, method, solver)
    loaded = load_climb(spec, overrides)
    check_model_path(save_model)
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        # The planner and its solvers take a second to import: not before all paths are good.
        from climbplan.climb.planner import plan_climb as plan
        from climbplan.plans.climb_file import write_climb
        from climbplan.plans.verification import verify_and_mark
        from climbplan.reports.climb_report import report_dict, write_report

        with StageProgress(session) as progress:
            with placed_mistakes(loaded):
                found = plan(loaded, report=progress.report, jobs=jobs, save_model=save_model)
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
