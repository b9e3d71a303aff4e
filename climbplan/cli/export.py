"""`climbplan export`: a plan for a robot or another simulator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, print_result, standard_output, warn
from climbplan.cli.options import Force, Quiet, Verbose, takes_options
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.api.kinds import PlanKind
    from climbplan.exports.formats import Format
    from climbplan.exports.motion import RobotMotion


# Names of `climbplan.exports.formats.FORMATS`, of motions and regulators, not imported for --help
FormatName = Literal["csv", "npz", "mcap", "ros2", "jtc", "usd", "motion", "regulator"]
_SAMPLED_FORMATS = ("csv", "npz", "mcap", "ros2")  # others are interpolated where they are used
_MAX_SPACING = 0.06  # [s] between samples, above which a controller needs more of them
TRACKED_MOTION = "tracked_motion.npz"  # beside the plan; `motion.npz` is of --format npz


@dataclass(frozen=True)
class MotionOptions:
    """Options of motions as they were given."""

    rate: float | None = None
    gains: str | None = None
    feedforward: bool = False
    gravity: bool | None = None
    ramp: float | None = None
    pace: str | None = None


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Plan and options of `climbplan export` as they are given."""

    plan: Annotated[
        Path | None,
        typer.Argument(metavar="PLAN", help="Plan file, or the output directory it is in."),
    ] = None
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File or directory, or - for CSV on standard output [default: beside the plan].",
        ),
    ] = None
    format_: Annotated[
        FormatName,
        typer.Option(
            "--format",
            help="Format: csv; npz: NumPy arrays; mcap: one file of ROS 2 messages; ros2: a bag "
            "of ROS 2; jtc: parameters and goal of a JointTrajectoryController; usd: an animated "
            "scene; motion: NPZ with contacts for motion-tracking pipelines; regulator: code and "
            "tables that correct joint commands by measured joint angles.",
        ),
    ] = "csv"
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Sample rate [Hz] [default: the plan's own samples; 50 with motion].",
        ),
    ] = None
    gains: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|FILE|rigid",
            help="P gains of the controller [N m/rad]: a number, a YAML file of `joint: gain`, or "
            "rigid for simulators whose links do not bend [default: the robot's joint_stiffness].",
        ),
    ] = None
    feedforward: Annotated[
        bool,
        typer.Option(
            "--feedforward",
            help="Torques as a feedforward term of their own: commanded angles are then the "
            "planned ones, whatever the gains are.",
        ),
    ] = False
    gravity: Annotated[
        bool | None,
        typer.Option(
            "--gravity/--no-gravity",
            help="Whether efforts include the torques that hold the links' own weight [default: "
            "with jtc].",
        ),
    ] = None
    ramp: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            min=0,
            help="Duration of the load ramps before and after the plan [s] [default: 3 with jtc, "
            "else 0].",
        ),
    ] = None
    pace: Annotated[
        str | None,
        typer.Option(
            metavar="FACTOR|fastest",
            help="With motion: factor on the planned speed of a climb, its contact forces solved "
            "again with the inertia of its links, or the fastest that they allow [default: 1].",
        ),
    ] = None
    unverified: Annotated[
        bool,
        typer.Option(
            "--unverified",
            help="Export also of a plan that fails its verification; the exported files say so.",
        ),
    ] = False
    instances: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory for the public set of contact problems (.mps and .nl files, a table "
            "and a checker), in place of a plan.",
            rich_help_panel="export --instances",
        ),
    ] = None
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=0,
            help="Seed of the set [default: 0, for which best values are known].",
            rich_help_panel="export --instances",
        ),
    ] = None
    count: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Number of instances of each family and class [default: 9, 216 in all].",
            rich_help_panel="export --instances",
        ),
    ] = None
    quiet: Quiet = False
    verbose: Verbose = False
    force: Force = False

    @property
    def motion(self) -> MotionOptions:
        """The options that only motions have."""
        return MotionOptions(
            self.rate, self.gains, self.feedforward, self.gravity, self.ramp, self.pace
        )


@takes_options(ExportOptions)
def export(context: typer.Context, options: ExportOptions) -> None:
    """Write a plan for a robot or another simulator and print the path.

    Without options a CSV: of a climb its trajectory (trajectory.csv), of a bookshelf plan the
    places of all books (placements.csv), of a walk its samples (walk.csv). With another format, a
    rate or gains: the motion with velocities, accelerations and torques. Beside tables of motions
    stands a JSON file of frames, signs and gains. Exit code 5 if the plan fails its verification,
    unless --unverified is given.
    """
    if options.instances is not None:
        print_result(str(_write_instances(context, options, options.instances)))
        return
    if options.plan is None:
        raise UsageError("expected a PLAN, or --instances DIR for the set of problems")
    if options.seed is not None or options.count is not None:
        raise UsageError("--seed and --count go with --instances")
    path = find_plan(options.plan)
    from climbplan.api.kinds import identify_kind
    from climbplan.cli.unsound import require_verified

    kind = identify_kind(path)
    remark = require_verified(kind, path, options.unverified)
    if options.format_ == "regulator":
        print_result(str(_write_regulator(context, path, options, remark)))
    elif options.format_ == "motion":
        print_result(str(_write_tracked_motion(kind, path, options, remark)))
    elif options.format_ != "csv" or options.motion != MotionOptions():
        print_result(str(_write_motion(kind, path, options, remark)))
    elif options.out == "-":
        with standard_output() as stream:
            if remark:
                stream.write(f"# {remark}\n")
            kind.export_csv(path, stream)
    else:
        print_result(str(_write_csv(kind, path, options, remark)))


def _write_instances(context: typer.Context, options: ExportOptions, target: Path) -> Path:
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress

    has_motion_options = options.motion != MotionOptions() or options.unverified
    has_plan_options = options.out is not None or options.format_ != "csv" or has_motion_options
    if options.plan is not None or has_plan_options:
        raise UsageError("--instances DIR: expected no PLAN and no option of motions with it")
    from climbplan.instances.families import COUNT
    from climbplan.instances.writing import KNOWN_SEED, write_set

    session = context.ensure_object(Invocation)
    set_seed = KNOWN_SEED if options.seed is None else options.seed
    each = COUNT if options.count is None else options.count
    with OutputDirectory(target, options.force) as output, StageProgress(session) as progress:
        number = write_set(output.path, set_seed, each, progress.report)
        output.publish()
    session.note(f"{number} instances, seed {set_seed}; instances.csv lists them")
    return target


def _write_csv(kind: PlanKind, path: Path, options: ExportOptions, remark: str) -> Path:
    from climbplan.cli.unsound import mark_unverified

    target = Path(options.out) if options.out is not None else path.parent / kind.csv_name
    _require_free(target, options.force)
    kind.export_csv(path, target)
    mark_unverified(target, remark)
    return target


def _write_regulator(
    context: typer.Context, path: Path, options: ExportOptions, remark: str
) -> Path:
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.unsound import mark_unverified
    from climbplan.climb.exports.regulator_files import write_regulator

    if options.out == "-" or options.motion != MotionOptions(gains=options.gains):
        raise UsageError(
            "--format regulator: code and tables for any rate; expected --gains or nothing, no "
            "--rate, no other option and no -o -"
        )
    target = Path(options.out) if options.out is not None else path.parent / "regulator"
    with OutputDirectory(target, options.force) as output:
        took = write_regulator(path, options.gains, output.path)
        mark_unverified(output.path, remark)
        output.publish()
    context.ensure_object(Invocation).note(
        f"a tick takes {1e6 * took.median:.0f} us here "
        f"(median; 99 %: {1e6 * took.percentile_99:.0f} us)"
    )
    return target


def _write_tracked_motion(kind: PlanKind, path: Path, options: ExportOptions, remark: str) -> Path:
    from climbplan.motions.motion_file import name_terrain_file, write_motion_file

    if options.out == "-" or options.motion != MotionOptions(options.rate, pace=options.pace):
        raise UsageError(
            "--format motion: the kinematic motion with its contacts; expected --rate, --pace or "
            "nothing, no other option and no -o -"
        )
    target = Path(options.out) if options.out is not None else path.parent / TRACKED_MOTION
    if target.suffix != ".npz":
        raise UsageError(f"{target}: expected a file that ends with .npz")
    for file in (target, name_terrain_file(target)):
        _require_free(file, options.force)
    motion = kind.read_tracked_motion(path, options.rate, _parse_pace(options.pace))
    facts = {**motion.facts, "verification": remark or "passed"}
    for note in motion.notes:
        warn(note)
    write_motion_file(replace(motion, is_verified=not remark, facts=facts), target)
    return target


def _parse_pace(text: str | None) -> float | Literal["fastest"]:
    """Return the value of `--pace`; raises UsageError for anything but a factor or `fastest`."""
    if text is None or text == "fastest":
        return "fastest" if text else 1.0
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not 0.1 <= factor <= 20:
        raise UsageError(f"--pace {text}: expected a factor of 0.1 to 20, or fastest")
    return factor


def _write_motion(kind: PlanKind, path: Path, options: ExportOptions, remark: str) -> Path:
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.unsound import mark_unverified, name_unverified
    from climbplan.exports.formats import (
        FORMATS,
        ControllerOptions,
        adapt_motion,
        apply_trajectory_controller_defaults,
    )

    if options.out == "-":
        raise UsageError("-o -: only the plain CSV goes to standard output")
    chosen = FORMATS[options.format_]
    target = _choose_target(path.parent, options.out, chosen)
    if not chosen.directory:
        _require_free(target, options.force)
    if options.pace is not None:
        raise UsageError("--pace goes with --format motion")
    plan = kind.read_motion(path)
    how = ControllerOptions(options.rate, options.gains, options.feedforward)
    if options.format_ == "jtc":
        how = apply_trajectory_controller_defaults(plan, how)
    if options.gravity is not None:
        how = replace(how, gravity=options.gravity)
    if options.ramp is not None:
        how = replace(how, ramp=options.ramp)
    motion = adapt_motion(plan, how)
    for note in motion.words:
        warn(note)
    if options.rate is None and options.format_ in _SAMPLED_FORMATS:
        _warn_of_sparse_samples(motion)
    motion = name_unverified(motion, remark)
    if chosen.directory:
        with OutputDirectory(target, options.force) as output:
            chosen.write(motion, output.path)
            mark_unverified(output.path, remark)
            output.publish()
    else:
        chosen.write(motion, target)
        mark_unverified(target, remark)
    return target


def _choose_target(folder: Path, out: str | None, chosen: Format) -> Path:
    """Return where an export goes; a file gets its usual name in a directory, and its suffix."""
    target = Path(out) if out is not None else folder / chosen.name
    if chosen.directory:
        return target
    if target.is_dir():
        return target / chosen.name
    return target if target.suffix else target.with_suffix(Path(chosen.name).suffix)


def _warn_of_sparse_samples(motion: RobotMotion) -> None:
    """Warn that the samples of a plan, exported as they are, are too few for a controller."""
    spacing = max((b - a for a, b in pairwise(map(float, motion.time))), default=0.0)
    if spacing > _MAX_SPACING:
        warn(f"samples are up to {spacing:.2g} s apart: --rate 100 puts splines through them")


def _require_free(target: Path, force: bool) -> None:
    if target.exists() and not force:
        raise UsageError(f"{target}: already exists; --force replaces it")
    if not target.absolute().parent.is_dir():
        raise UsageError(f"{target}: no such directory {str(target.parent)!r}")
