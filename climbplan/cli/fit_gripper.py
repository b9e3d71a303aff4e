"""`climbplan fit-gripper`: shear force of a spine gripper from measured grips."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Verbose


def fit_gripper(
    context: typer.Context,
    data: Annotated[Path, typer.Argument(metavar="DATA.csv", help="Measured grips.")],
    *,
    out: Out = None,
    seed: Seed = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Learn the shear force of a spine gripper, and how far its bounds can be trusted.

    DATA.csv has one grip a row: alpha_deg, beta_deg, gamma_deg, friction, force_N. Prints the path
    of gripper.json (plain numbers); beside it report.json and figures/calibration.png.
    """
    from climbplan.cli.output_directory import OutputDirectory

    session = context.ensure_object(Invocation)
    target = out if out is not None else Path("outputs", data.stem)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.mechanics.gripper import cross_validate, read_grips
        from climbplan.mechanics.gripper import fit_gripper as fit
        from climbplan.reports.fits.gripper_report import RESULT, build_report, write_report

        grips = read_grips(data)
        model = fit(grips, seed or 0)
        calibration = cross_validate(grips, seed=seed or 0)
        fraction_above = calibration.share_above(grips, 0.95)
        session.note(
            f"{data.stem}   {len(grips.force)} grips, noise {model.noise:.2f} N, "
            f"held-out error {calibration.rmse:.2f} N, {fraction_above:.1%} above their 95 % bound"
        )
        write_report(model, calibration, grips, data.stem, directory.path)
        directory.publish()
    if as_json:
        report = build_report(model, calibration, grips, data.stem)
        print_json({**report, "file": str(target / RESULT)})
    else:
        print_result(str(target / RESULT))
