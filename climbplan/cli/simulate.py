"""`climbplan simulate`: a plan replayed in MuJoCo and held against what was planned."""

from __future__ import annotations

from pathlib import Path

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, print_json, print_result, warn
from climbplan.cli.options import takes_options
from climbplan.cli.simulate_options import (
    Regulated,
    SimulateOptions,
    SimulationEngine,
    build_request,
    parse_scale,
    parse_sweep,
)
from climbplan.errors import UsageError, VerificationFailed


@takes_options(SimulateOptions)
def simulate(context: typer.Context, options: SimulateOptions) -> None:
    """Replay a climb, transition, walk or plan of modules in MuJoCo and compare it with its plan.

    Climbs and transitions: torques, friction and deflection of the whole robot. Walks (plans of
    kind mpc): one rigid body pushed off feet by the planned forces, or the whole robot with its
    links' masses and joint torques where it comes from a URDF. Modules: chains of links with
    servos, whose latches are constraints that break at their limits (in massless plans links weigh
    next to nothing and nothing breaks).

    Prints the path of simulation.csv, with one row a standing limb or closed contact and instant.
    Next to it are report.json, report.html, figures/ and simulation.gif, with --worlds also
    worst_world.gif. Needs `pip install 'climbplan[simulate]'`.

    Exit code 5 if the robot falls in the run without random changes, or if more than --most-slips
    toes slide (over 5 mm) or do not touch where they should (0.5 s; walks 0.02 s). Of modules: if
    they lose the box, or more than --most-slips of their contacts break or miss. --runs, --sweep
    and --worlds are studies, which do not change the exit code. A world is drawn from the spec's
    `uncertainty` and depends on --seed and its number alone.

    With --engine drake (`pip install 'climbplan[drake]'`) the files that `climbplan export` writes
    are played in Drake, beside them simulation.csv and report.json; of the other options
    --friction, --gain, --armature =VALUE (default =0), --damping FACTOR, --regulate joints or
    nothing, --most-slips and --allow-falls go with it.
    """
    path = find_plan(options.plan)
    sweep = parse_sweep(options.sweep)
    if options.seed is not None and options.seed < 0:
        raise UsageError(f"--seed {options.seed}: expected a whole number >= 0")
    session = context.ensure_object(Invocation)
    if options.engine is SimulationEngine.drake:
        _play_in_drake(session, path, options)
        return
    if options.urdf is not None or options.sphere_toes:
        raise UsageError("--urdf and --sphere-toes go with --engine drake")
    if options.closed_loop and (
        options.engine is not SimulationEngine.mujoco or options.regulate or options.speed != 1.0
    ):
        raise UsageError(
            "--closed-loop: expected --engine mujoco, and no --regulate or --speed beside it"
        )
    if options.rare and (not options.worlds or options.engine is not SimulationEngine.statics):
        raise UsageError("--rare: expected --worlds N and --engine statics beside it")
    if options.engine is SimulationEngine.statics and not options.worlds:
        raise UsageError(
            "--engine statics: expected --worlds N beside it: MuJoCo makes single runs"
        )
    _replay(session, path, options, sweep)


def _play_in_drake(session: Invocation, path: Path, options: SimulateOptions) -> None:
    """Play the exported files of a plan in Drake; raises UsageError for other engines' options."""
    mujoco_options = (
        options.runs, options.sweep, options.payload, options.backlash_deg,
        options.limb_mass_share, not options.limb_weights, options.speed != 1.0,
        options.random_backlash_deg, options.delay_ms, options.joint_noise_deg, options.push,
        options.worlds, options.rare, options.closed_loop, options.replans is not None,
    )  # fmt: skip
    rotors = parse_scale("--armature", options.armature)
    gains = parse_scale("--damping", options.damping)
    if (rotors.value is None and rotors.factor != 1.0) or gains.value is not None:
        raise UsageError(
            "--engine drake: expected --armature =VALUE [kg m^2; default =0] and --damping "
            "FACTOR on the exported D gains [default 1]"
        )
    if any(mujoco_options) or options.regulate in (Regulated.attitude, Regulated.pose):
        raise UsageError(
            "--engine drake: expected no option of other engines; --friction, --gain, "
            "--armature, --damping, --regulate joints or nothing, --urdf, --sphere-toes, "
            "--most-slips and --allow-falls go with it"
        )
    from climbplan.cli.simulate_drake import DrakeOptions, OutputOptions, run_in_drake

    run_in_drake(
        session,
        path,
        DrakeOptions(
            options.friction,
            options.gain,
            0.0 if rotors.value is None else rotors.value,
            gains.factor,
            options.regulate,
            options.urdf,
            options.sphere_toes,
        ),
        OutputOptions(
            options.out, options.force, options.as_json, options.most_slips, options.allow_falls
        ),
    )


def _replay(
    session: Invocation, path: Path, options: SimulateOptions, sweep: tuple[str, tuple[float, ...]]
) -> None:
    """Replay a plan in MuJoCo or quasi-static steps, write the record, and print its path.

    Raises:
        VerificationFailed: the robot falls, or loses more contacts than --most-slips.
    """
    from climbplan.api.simulating import find_simulator

    kind = find_simulator(path)
    from climbplan.api.kinds import identify_kind
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.unsound import warn_of_failure
    from climbplan.simulation.report_files import RESULT, write_simulation

    request = build_request(options, sweep)
    warn_of_failure(identify_kind(path), path)
    name, run = kind(path)
    target = options.out if options.out is not None else Path("outputs", f"{name}_simulation")
    with OutputDirectory(target, force=options.force) as directory:
        with StageProgress(session) as progress:
            record, outcome = run(request, progress.report)
        session.note(f"{name}   {record.headline}")
        for line in outcome:
            session.note(f"  {line}")
        picture_note = record.report["pictures"]
        if options.pictures and record.film is None:
            warn(picture_note)
        write_simulation(record, directory.path)
        directory.publish()
    failure = "" if options.allow_falls else record.end.failure(options.most_slips)
    if options.as_json:
        where = {"plan": str(path), "file": str(target / RESULT)}
        print_json({**record.report, **where})
    else:
        print_result(str(target / RESULT))
    if failure:
        raise VerificationFailed(failure)
