"""`climbplan simulate --engine drake`: exported files played in a second engine."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.errors import VerificationFailed


@dataclass(frozen=True)
class DrakeOptions:
    """What of the world differs from the plan, as the command line has it."""

    friction: float  # factor on the coefficients
    gain: float  # factor on the P gains
    armature: float  # rotor inertia of every joint [kg m^2]
    damping: float  # factor on the D gains
    regulate: str | None  # "joints", "nothing", None for the default
    urdf: Path | None  # for meshes
    sphere_toes: bool


@dataclass(frozen=True)
class OutputOptions:
    """Where the result goes and what ends with an error."""

    out: Path | None
    force: bool
    as_json: bool
    most_slips: int | None
    allow_falls: bool


def run_in_drake(
    session: Invocation, plan: Path, options: DrakeOptions, output: OutputOptions
) -> None:
    """Play a plan in Drake, write the result, and print its path or the report.

    Raises PlanFails if the robot falls, or where more toes slide or lose contact than may.
    """
    from climbplan.api.kinds import identify_kind
    from climbplan.api.second_engine import plan_name, simulate_in_drake
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.unsound import warn_of_failure
    from climbplan.simulation.drake import report as reports
    from climbplan.simulation.drake.settings import Settings

    settings = Settings(
        gain_scale=options.gain,
        friction_scale=options.friction,
        armature=options.armature,
        damping_scale=options.damping,
        regulate=options.regulate != "nothing",
        urdf_toes=not options.sphere_toes,
    )
    warn_of_failure(identify_kind(plan), plan)
    target = output.out if output.out is not None else Path("outputs", f"{plan_name(plan)}_drake")
    with OutputDirectory(target, force=output.force) as directory:
        with StageProgress(session) as progress:
            run = simulate_in_drake(plan, directory.path, settings, options.urdf, progress.report)
        report = reports.build_report(run)
        session.note(f"{run.motion.name}   {reports.summarise_run(report)}")
        for line in reports.format_lines(report):
            session.note(f"  {line}")
        text = json.dumps(report, indent=2, allow_nan=False) + "\n"
        (directory.path / "report.json").write_text(text, encoding="utf-8")
        (directory.path / "simulation.csv").write_text(reports.format_table(run), encoding="utf-8")
        directory.publish()
    if output.as_json:
        print_json({**report, "plan": str(plan), "file": str(target / "simulation.csv")})
    else:
        print_result(str(target / "simulation.csv"))
    failure = reports.explain_failure(report, output.most_slips or 0)
    if failure and not output.allow_falls:
        raise VerificationFailed(failure)
