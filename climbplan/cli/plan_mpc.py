"""`climbplan plan-mpc`: from a spec to a verified walk and its report."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.compiling import compiling_told
from climbplan.cli.console import Session, print_json, print_result, warn
from climbplan.cli.mistakes import placed_mistakes
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Set, Spec, TimeLimit, Verbose
from climbplan.cli.plan_path import PLAN_FILE
from climbplan.cli.verify_line import verify_line
from climbplan.errors import ExitCode

LIBRARY_FILE = "library.h5"


def plan_mpc(
    context: typer.Context,
    spec: Spec,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    time_limit: TimeLimit = None,
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Method: search, nlp, micp or online."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Plan a quadruped's walk: footsteps, gait, body motion and contact forces together.

    Prints the path of the plan file. Its directory also holds report.json, report.html and
    figures/. Method `online` walks in closed loop and also leaves library.h5, which
    `library.file` takes. Exit code 4 if a limit was reached without a plan, 5 if the plan fails
    its verification, as when the robot falls.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.spec.mpc_loading import load_mpc

    session = context.ensure_object(Session)
    loaded = load_mpc(spec, spec_overrides(assignments, seed, time_limit, method))
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        # The planner and its solvers take a second to import: not before all paths are good.
        from climbplan.mpc.plan_file import write_walk_plan
        from climbplan.mpc.planner import plan_walk
        from climbplan.mpc.verification import verify_and_mark
        from climbplan.reports.walk_report import report_dict, write_report

        with StageProgress(session) as progress:
            with compiling_told(session), placed_mistakes(loaded):
                if loaded.spec.solver.method == "online":
                    from climbplan.mpc.library import write_library
                    from climbplan.mpc.online_run import run_online

                    run = run_online(loaded, progress.report)
                    found = run.plan
                    write_library(run.library, directory.path / LIBRARY_FILE, run.key)
                else:
                    found = plan_walk(loaded, progress.report)
            progress.report("verify", 0.0)  # ends the bar before lines are printed
            for line in found.summary:
                session.note(line)
            for warning in found.warnings:
                warn(warning)
            plan_file = directory.path / PLAN_FILE
            write_walk_plan(found, plan_file)
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
