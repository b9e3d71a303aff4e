"""`climbplan simulate`: a plan replayed in MuJoCo and held against what was planned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Session, print_json, print_result, warn
from climbplan.cli.options import Force, Json, Out, Plan, Quiet, Seed, Verbose
from climbplan.cli.plan_path import find_plan
from climbplan.errors import PlanFileError, UsageError


def simulate(
    context: typer.Context,
    plan: Plan,
    out: Out = None,
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", min=0, help="Random runs (of each swept value).")
    ] = 0,
    sweep: Annotated[
        str | None,
        typer.Option(
            "--sweep",
            metavar="KEY=V1,V2,...",
            help="Plan anew at these values: force.safety_friction=1,1.5,2.",
        ),
    ] = None,
    friction: Annotated[
        float, typer.Option("--friction", metavar="FACTOR", min=0.0, help="On the coefficients.")
    ] = 1.0,
    payload: Annotated[
        float, typer.Option("--payload", metavar="KG", help="Mass the plan does not know.")
    ] = 0.0,
    gain: Annotated[
        float, typer.Option("--gain", metavar="FACTOR", min=0.01, help="On the motors' P gain.")
    ] = 1.0,
    backlash_deg: Annotated[
        float, typer.Option("--backlash-deg", metavar="DEG", min=0.0, help="Play of every joint.")
    ] = 0.0,
    limb_mass_share: Annotated[
        float | None,
        typer.Option(
            "--limb-mass-share",
            metavar="SHARE",
            min=0.0,
            max=0.95,
            help="Part of the mass that is in the limbs [default: 0.02].",
        ),
    ] = None,
    limb_weights: Annotated[
        bool,
        typer.Option(
            "--limb-weights/--no-limb-weights", help="Whether motors are told to carry the links."
        ),
    ] = True,
    speed: Annotated[
        float, typer.Option("--speed", metavar="FACTOR", min=0.01, help="On the plan's pace.")
    ] = 1.0,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Whether to render a strip of images.")
    ] = True,
    seed: Seed = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Replay a climb in MuJoCo and compare torques, friction and sag with the planned ones.

    Prints the path of simulation.csv (default directory: outputs/<plan's name>_simulation), one row
    a standing limb and instant; beside it report.json and figures/. Needs `pip install
    'climbplan[simulate]'`.
    """
    path = find_plan(plan)
    key, values = _swept(sweep)
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.plans.climb_file import read_climb
    from climbplan.plans.plan_format import plan_format

    found_format = plan_format(path)
    if found_format != "climbplan/climb":
        raise PlanFileError(f"{path}: holds {found_format!r}, `simulate` replays climbs")
    from climbplan.simulation.conditions import LIMB_MASS_SHARE, Conditions

    conditions = Conditions(
        friction=friction,
        payload=payload,
        gain=gain,
        limb_mass_share=LIMB_MASS_SHARE if limb_mass_share is None else limb_mass_share,
        backlash=backlash_deg * 3.141592653589793 / 180,
        limb_weights=limb_weights,
        speed=speed,
    )
    session = context.ensure_object(Session)
    climb = read_climb(path)
    target = out if out is not None else Path("outputs", f"{climb.name}_simulation")
    with OutputDirectory(target, force=force) as directory:
        from climbplan.simulation.study import (
            RESULT,
            headline,
            report_dict,
            simulate_plan,
            write_report,
        )

        with StageProgress(session) as progress:
            found = simulate_plan(
                climb,
                conditions,
                runs=runs,
                sweep_key=key,
                sweep_values=values,
                seed=seed or 0,
                pictures=pictures,
                progress=progress.report,
            )
        session.note(f"{climb.name}   {headline(found)}")
        for point in found.points:
            what = point.no_plan or f"{point.share.fallen} of {point.share.runs} runs fall"
            session.note(f"  {key} {point.value:g}: {what}")
        if found.trials:
            session.note(
                f"  {sum(t.fallen for t in found.trials)} of {len(found.trials)} runs fall"
            )
        if pictures and isinstance(found.camera, str):
            warn(found.camera)
        write_report(found, directory.path)
        directory.publish()
    if as_json:
        print_json(report_dict(found))
    else:
        print_result(str(target / RESULT))


def _swept(text: str | None) -> tuple[str, list[float]]:
    if text is None:
        return "", []
    key, mark, listed = text.partition("=")
    try:
        values = [float(value) for value in listed.split(",")]
    except ValueError:
        values = []
    if not key or not mark or not values:
        raise UsageError(f"--sweep {text}: expected KEY=V1,V2,... with numbers")
    return key, values
