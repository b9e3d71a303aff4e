"""`climbplan fit-stiffness`: joint stiffness and structure from force-displacement tests."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Verbose
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.mechanics.identification.study import Identification
    from climbplan.robots.model import Robot


def fit_stiffness(
    context: typer.Context,
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA.csv", help="Load tests or stiffness matrices of one limb."),
    ],
    *,
    robot: Annotated[
        str,
        typer.Option(
            "--robot",
            metavar="NAME",
            help="Robot whose limb was measured: a built-in name or a file.",
        ),
    ] = "silvia",
    limb: Annotated[
        str | None,
        typer.Option("--limb", metavar="NAME", help="Limb that was measured [default: the first]."),
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
    from climbplan.schema.robots.source import load_any_robot

    session = context.ensure_object(Invocation)
    limb_of = build_robot(load_any_robot(robot))
    number = 0 if limb is None else _find_limb(limb_of, limb)
    target = out if out is not None else Path("outputs", data.stem)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.mechanics.identification.study import identify
        from climbplan.reports.fits.stiffness_report import RESULT, build_report, write_report

        with StageProgress(session) as progress:
            identification = identify(
                data, limb_of, seed or 0, lambda part: progress.report("fit", part), number
            )
        for line in _summary(identification, data.stem, limb_of.name):
            session.note(line)
        write_report(identification, data.stem, directory.path)
        directory.publish()
    if as_json:
        print_json({**build_report(identification, data.stem), "file": str(target / RESULT)})
    else:
        print_result(str(target / RESULT))


def _summary(identification: Identification, name: str, robot_name: str) -> list[str]:
    best = identification.best
    return [
        *(f"left out: {line}" for line in identification.measurements.skipped),
        f"{name}   {robot_name}: {len(best.matrices)} matrices, {best.model.name}",
        *(f"  {line}" for line in identification.findings),
    ]


def _find_limb(robot: Robot, name: str) -> int:
    """Return the number of a limb; raises UsageError if the robot has none of that name."""
    from climbplan.schema.fields import find_closest_name

    names = robot.limb_names
    if name in names:
        return names.index(name)
    suggestion = find_closest_name(name, list(names))
    hint = f"; did you mean {suggestion!r}?" if suggestion else ""
    raise UsageError(f"--limb {name!r}: {robot.name} has the limbs {', '.join(names)}{hint}")
