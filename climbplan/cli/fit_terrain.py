"""`climbplan fit-terrain`: contact regions of a mesh, a point cloud or a height map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Quiet, Verbose
from climbplan.cli.quick import NoReport
from climbplan.errors import UsageError

MOST_OPENING = 0.5  # [m]

ScanSettings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="KEY=VALUE",
        help="Value for a key of terrain.scan, such as flatness=0.003; repeatable.",
    ),
]
FingerOpening = Annotated[
    float | None,
    typer.Option(
        "--holds",
        metavar="OPENING",
        help="Opening of a gripper's fingers [m]: find what it can hold, in place of regions.",
    ),
]


def fit_terrain(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Mesh, point cloud or height map.")],
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Output directory [default: outputs/<file's name>_terrain].",
        ),
    ] = None,
    settings: ScanSettings = None,
    holds: FingerOpening = None,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Find where toes may stand in a scanned surface, and show it.

    FILE: a mesh (STL, OBJ, PLY, GLB, DAE), a point cloud (PCD, PLY, XYZ, NPY, LAS) or a height map
    (TIFF, PNG, NPY, CSV, with `--set cell=0.02`). Prints the path of terrain.yaml, the part
    `terrain:` of a spec with all regions, to be edited; beside it report.json and report.html. The
    folder is outputs/NAME_terrain by default, as specs of the same name plan into outputs/NAME.
    With --holds it has the wall as `panel` with its graspable spots, or those of closed bodies as
    `regions`, each with a `hold`; there is no page.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress

    session = context.ensure_object(Invocation)
    target = out if out is not None else Path("outputs", f"{file.stem}_terrain")
    if holds is not None:
        _fit_holds(session, file, target, holds, settings or [], as_json, force=force)
        return
    with OutputDirectory(target, force=force) as directory:
        from climbplan.reports.fits.terrain_report import RESULT, build_report, write_report
        from climbplan.scan.study import build_scan_spec, fit

        scan = build_scan_spec(file, settings or [])
        with StageProgress(session) as progress:
            fitted = fit(scan, lambda part: progress.report("fit", part))
        for note in fitted.raw.notes:
            session.note(f"{file.stem}   {note}")
        session.note(f"{file.stem}   {fitted.headline}")
        report = build_report(fitted, file.stem)
        write_report(fitted, report, directory.path, page=not no_report)
        directory.publish()
    if as_json:
        print_json({**report, "file": str(target / RESULT)})
    else:
        print_result(str(target / RESULT))


def _fit_holds(
    session: Invocation,
    file: Path,
    target: Path,
    opening: float,
    settings: list[str],
    as_json: bool,
    *,
    force: bool,
) -> None:
    from climbplan.cli.output_directory import OutputDirectory

    if not 0 < opening <= MOST_OPENING:
        raise UsageError(
            f"--holds: expected an opening of 0 to {MOST_OPENING:g} m, got {opening:g}"
        )
    with OutputDirectory(target, force=force) as directory:
        from climbplan.reports.fits.holds_report import find_graspable, write_holds
        from climbplan.reports.fits.terrain_report import RESULT
        from climbplan.scan.holds import Grasping
        from climbplan.scan.reading import read_scan
        from climbplan.scan.study import build_scan_spec

        scan = build_scan_spec(file, settings)
        raw = read_scan(scan, Path())
        graspable_spots = find_graspable(raw, scan, Grasping(opening), file.stem)
        for note in (*raw.notes, graspable_spots.headline):
            session.note(f"{file.stem}   {note}")
        report = graspable_spots.report
        write_holds(graspable_spots, directory.path)
        directory.publish()
    if as_json:
        print_json({**report, "file": str(target / RESULT)})
    else:
        print_result(str(target / RESULT))
