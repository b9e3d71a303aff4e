"""`climbplan export`: a plan for a robot or another simulator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Session, print_result, standard_output, warn
from climbplan.cli.options import Force, Plan, Quiet, Verbose
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.api.kinds import PlanKind

# Names of `climbplan.exports.formats.FORMATS` and the regulator's, not imported for --help
FormatName = Literal["csv", "npz", "mcap", "ros2", "jtc", "usd", "regulator"]


def export(
    context: typer.Context,
    plan: Plan,
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File or directory, or - for CSV on standard output [default: beside the plan].",
        ),
    ] = None,
    format_: Annotated[
        FormatName,
        typer.Option(
            "--format",
            help="csv; npz: NumPy arrays; mcap: one file of ROS 2 messages; ros2: a bag of ROS 2; "
            "jtc: parameters and goal of a JointTrajectoryController; usd: an animated scene; "
            "regulator: code and tables that correct commands by joint angles.",
        ),
    ] = "csv",
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Samples a second [default: the plan's own samples]."),
    ] = None,
    gains: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|FILE",
            help="P gains of the controller [N m/rad]: one number, or a YAML file of `joint: gain` "
            "[default: the robot's joint_stiffness].",
        ),
    ] = None,
    feedforward: Annotated[
        bool,
        typer.Option(
            "--feedforward",
            help="Tell torques apart: commands are the angles, whatever the gains are.",
        ),
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Write a plan for a robot or another simulator and print the path.

    Without options a CSV: of a climb its trajectory (trajectory.csv), of a bookshelf plan the
    places of all books (placements.csv), of a walk its samples (walk.csv). With another format, a
    rate or gains: the motion with velocities, accelerations and torques.
    """
    path = find_plan(plan)
    from climbplan.api.kinds import plan_kind
    from climbplan.cli.unsound import warn_of_failure

    kind = plan_kind(path)
    warn_of_failure(kind, path)
    if format_ == "regulator":
        print_result(str(_regulator(context, path, out, (rate, gains, feedforward), force)))
        return
    if format_ != "csv" or rate is not None or gains is not None or feedforward:
        print_result(str(_motion(kind, path, out, format_, (rate, gains, feedforward), force)))
        return
    if out == "-":
        with standard_output() as stream:
            kind.export_csv(path, stream)
        return
    target = Path(out) if out is not None else path.parent / kind.csv_name
    _require_free(target, force)
    kind.export_csv(path, target)
    print_result(str(target))


def _regulator(
    context: typer.Context,
    path: Path,
    out: str | None,
    asked: tuple[float | None, str | None, bool],
    force: bool,
) -> Path:
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.exports.regulator_files import write_regulator

    rate, gains, feedforward = asked
    if out == "-" or rate is not None or feedforward:
        raise UsageError(
            "--format regulator: a directory of code and tables, for any rate; -o -, --rate and "
            "--feedforward do not go with it"
        )
    target = Path(out) if out is not None else path.parent / "regulator"
    with OutputDirectory(target, force) as output:
        took = write_regulator(path, gains, output.path)
        output.publish()
    context.ensure_object(Session).note(
        f"a tick takes {1e6 * took.median:.0f} us here (median; 99 %: {1e6 * took.most:.0f} us)"
    )
    return target


def _motion(
    kind: PlanKind,
    path: Path,
    out: str | None,
    format_: FormatName,
    asked: tuple[float | None, str | None, bool],
    force: bool,
) -> Path:
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.exports.formats import FORMATS, Told, told

    if out == "-":
        raise UsageError("-o -: only the plain CSV goes to standard output")
    chosen = FORMATS[format_]
    target = Path(out) if out is not None else path.parent / chosen.name
    if not chosen.directory:
        _require_free(target, force)
    rate, gains, feedforward = asked
    motion = told(kind.motion(path), Told(rate, gains, feedforward))
    for word in motion.words:
        warn(word)
    if chosen.directory:
        with OutputDirectory(target, force) as output:
            chosen.write(motion, output.path)
            output.publish()
    else:
        chosen.write(motion, target)
    return target


def _require_free(target: Path, force: bool) -> None:
    if target.exists() and not force:
        raise UsageError(f"{target}: already exists; --force replaces it")
    if not target.absolute().parent.is_dir():
        raise UsageError(f"{target}: no such directory {str(target.parent)!r}")
