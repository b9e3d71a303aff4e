"""`climbplan fit-stiffness`: joint stiffness and structure from force-displacement tests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Verbose
from climbplan.errors import UsageError


def fit_stiffness(
    context: typer.Context,
    data: Annotated[
        Path, typer.Argument(metavar="DATA.csv", help="Tests or stiffness matrices of one limb.")
    ],
    *,
    robot: Annotated[
        str,
        typer.Option(
            "--robot", metavar="NAME", help="Robot whose limb it is: a built-in name or a file."
        ),
    ] = "silvia",
    limb: Annotated[
        str | None,
        typer.Option("--limb", metavar="NAME", help="Which limb; the first if left out."),
    ] = None,
    out: Out = None,
    seed: Seed = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Identify joint stiffness and the structure's share from measurements of one limb.

    DATA.csv has one load step a row (test, femur_deg, tibia_deg, dx_mm, dz_mm, fx_N, fz_N; with
    coxa_deg, dy_mm and fy_N in space) or one matrix a row (Kxx_N_per_mm, Kxz_N_per_mm,
    Kzz_N_per_mm, and joint angles or the foot distance r_mm). Of a robot from a URDF angles go by
    its joints' names, NAME_deg, and axes are those of the body: x right, y forward, z up. Prints
    the path of stiffness.csv, the matrices measured and fitted; beside it report.json, with what
    the robot file of a URDF says of these joints (`robot_file`), and figures/.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.robots.any_robot import build_robot
    from climbplan.schema.fields import find_closest_name
    from climbplan.schema.robots.source import load_any_robot

    session = context.ensure_object(Invocation)
    limb_of = build_robot(load_any_robot(robot))
    names = limb_of.limb_names
    if limb is not None and limb not in names:
        suggestion = find_closest_name(limb, list(names))
        hint = f"; did you mean {suggestion!r}?" if suggestion else ""
        raise UsageError(f"--limb {limb!r}: {limb_of.name} has the limbs {', '.join(names)}{hint}")
    number = 0 if limb is None else names.index(limb)
    target = out if out is not None else Path("outputs", data.stem)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.mechanics.identification.study import identify
        from climbplan.reports.fits.stiffness_report import RESULT, build_report, write_report

        with StageProgress(session) as progress:
            identification = identify(
                data, limb_of, seed or 0, lambda part: progress.report("fit", part), number
            )
        for line in identification.measurements.skipped:
            session.note(f"left out: {line}")
        best = identification.best
        session.note(
            f"{data.stem}   {limb_of.name}: {len(best.matrices)} matrices, {best.model.name}"
        )
        for line in identification.findings:
            session.note(f"  {line}")
        write_report(identification, data.stem, directory.path)
        directory.publish()
    if as_json:
        print_json({**build_report(identification, data.stem), "file": str(target / RESULT)})
    else:
        print_result(str(target / RESULT))
