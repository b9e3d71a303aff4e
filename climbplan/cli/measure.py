"""`climbplan measure`: slip, penetration, limits, friction and power of motion files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Json, Quiet, Verbose, takes_options
from climbplan.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from climbplan.motions.completion import Completion


@dataclass(frozen=True, kw_only=True)
class MeasureOptions:
    """Motion files and options of `climbplan measure` as they are given."""

    motions: Annotated[
        list[Path],
        typer.Argument(metavar="MOTION...", help="NPZ files in the layout of --format motion."),
    ]
    robot: Annotated[
        Path | None,
        typer.Option(
            "--robot",
            metavar="URDF",
            help="URDF or MJCF of the robot, for kinematics, dynamics, and for limits, names and "
            "shapes of feet that files lack.",
        ),
    ] = None
    terrain: Annotated[
        Path | None,
        typer.Option(
            "--terrain",
            metavar="MESH",
            help="Triangle mesh of the terrain, world frame [default: that of each file].",
        ),
    ] = None
    ground: Annotated[
        float,
        typer.Option(
            "--ground", metavar="Z", help="Height of level ground where there is no terrain [m]."
        ),
    ] = 0.0
    feet: Annotated[
        str | None,
        typer.Option(
            "--feet",
            metavar="BODY,...",
            help="Bodies that may touch, for files without contacts.",
        ),
    ] = None
    foot_radius: Annotated[
        float | None,
        typer.Option(
            "--foot-radius",
            metavar="M",
            min=0,
            help="Radius of spheres about the origins of these bodies [m] [default: their "
            "collision shapes].",
        ),
    ] = None
    contact_distance: Annotated[
        float,
        typer.Option(
            "--contact-distance",
            metavar="M",
            min=0,
            help="Distance from the terrain up to which feet count as in contact [m].",
        ),
    ] = 0.02
    contact_speed: Annotated[
        float,
        typer.Option(
            "--contact-speed",
            metavar="M/S",
            min=0,
            help="Speed up to which feet count as in contact [m/s].",
        ),
    ] = 0.15
    limit: Annotated[
        list[str] | None,
        typer.Option(
            "--limit",
            metavar="MEASURE=VALUE",
            help="Limit of a measure, such as contact.slip=0.005; repeatable.",
        ),
    ] = None
    as_json: Json = False
    quiet: Quiet = False
    verbose: Verbose = False


@takes_options(MeasureOptions)
def measure(context: typer.Context, options: MeasureOptions) -> None:
    """Measure slip, penetration, limits, friction and power of motions.

    Motions are NPZ files as `export --format motion` writes them, or of other tools in the same
    layout. Each measure has a limit; what a file has no data for is not judged. Contacts that a
    file lacks follow from distance and speed of the bodies that --feet names. Exit code 5 if a
    measure is beyond its limit.
    """
    from climbplan.motions.completion import complete_motion
    from climbplan.motions.measure import measure_motion
    from climbplan.motions.motion_file import read_motion_file
    from climbplan.verification.verification import format_check_table

    session = context.ensure_object(Invocation)
    limits = _read_limits(options.limit or [])
    completion = _build_completion(options)
    answers: list[dict[str, Any]] = []
    for path in options.motions:
        motion, notes = complete_motion(read_motion_file(path), completion)
        for note in notes:
            session.note(f"{path.name}: {note}")
        checks = measure_motion(motion, limits, completion.robot)
        answers.append(
            {
                "file": str(path),
                "samples": len(motion.time),
                "fps": motion.fps,
                "verified": motion.is_verified,
                "passed": all(check.passed for check in checks),
                "notes": notes,
                "checks": [check.as_dict() for check in checks],
            }
        )
        if not options.as_json:
            heading = f"{path}: {len(motion.time)} samples at {motion.fps:g} Hz"
            print_result(f"{heading}\n{format_check_table(checks)}")
    passed = all(answer["passed"] for answer in answers)
    if options.as_json:
        print_json({"passed": passed, "motions": answers})
    if not passed:
        raise typer.Exit(ExitCode.UNVERIFIED)


def _read_limits(texts: list[str]) -> dict[str, float]:
    """Return limits by measure from `MEASURE=VALUE`."""
    limits = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            limits[name] = float(value)
        except ValueError:
            raise UsageError(f"--limit {text}: expected MEASURE=NUMBER") from None
        if not limits[name] >= 0:
            raise UsageError(f"--limit {text}: expected a number >= 0")
    return limits


def _build_completion(options: MeasureOptions) -> Completion:
    from climbplan.motions.completion import Completion, read_robot
    from climbplan.motions.contact_rule import Rule
    from climbplan.motions.motion_file import read_terrain_mesh

    feet = tuple(name.strip() for name in (options.feet or "").split(",") if name.strip())
    if options.feet is not None and not feet:
        raise UsageError("--feet: expected names of bodies, separated by commas")
    return Completion(
        robot=None if options.robot is None else read_robot(options.robot),
        terrain=None if options.terrain is None else read_terrain_mesh(options.terrain),
        ground_height=options.ground,
        feet=feet,
        foot_radius=options.foot_radius,
        rule=Rule(options.contact_distance, options.contact_speed),
    )
