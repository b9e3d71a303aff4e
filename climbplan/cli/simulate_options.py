"""Options of `climbplan simulate`, and the request for the simulator that they state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.cli.options import Force, Jobs, Json, Plan, Quiet, Seed, Verbose
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.simulation.request import SimulationRequest


class Regulated(StrEnum):
    """What of the body's pose a regulator corrects."""

    nothing = "nothing"
    attitude = "attitude"
    joints = "joints"
    pose = "pose"


class SimulationEngine(StrEnum):
    """What plays a plan: the model in MuJoCo, quasi-static steps (worlds alone), or Drake."""

    mujoco = "mujoco"
    statics = "statics"
    drake = "drake"


@dataclass(frozen=True, kw_only=True)
class SimulateOptions:
    """Plan and options of `climbplan simulate` as they are given."""

    plan: Plan
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Output directory [default: outputs/<plan's name>_simulation].",
        ),
    ] = None
    runs: Annotated[
        int,
        typer.Option(
            "--runs",
            metavar="N",
            min=0,
            help="Number of random runs in MuJoCo, for each value of --sweep: friction 50 to 105 "
            "%, up to 2 % more mass, motors' gain 95 to 105 %, one toe without friction for 0.2 "
            "s. They do not use the spec's `uncertainty`; --worlds does.",
        ),
    ] = 0
    sweep: Annotated[
        str | None,
        typer.Option(
            "--sweep",
            metavar="KEY=V1,V2,...",
            help="Key of the spec and values to plan again at, such as "
            "force.safety_friction=1,1.5,2; each plan is replayed with --runs random runs.",
        ),
    ] = None
    friction: Annotated[
        float,
        typer.Option(
            "--friction", metavar="FACTOR", min=0.0, help="Factor on all friction coefficients."
        ),
    ] = 1.0
    payload: Annotated[
        float,
        typer.Option(
            "--payload", metavar="KG", help="Mass [kg] on the body that the plan does not know."
        ),
    ] = 0.0
    gain: Annotated[
        float,
        typer.Option(
            "--gain",
            metavar="FACTOR",
            min=0.01,
            help="Factor on the proportional gain of all motors.",
        ),
    ] = 1.0
    backlash_deg: Annotated[
        float,
        typer.Option(
            "--backlash-deg", metavar="DEG", min=0.0, help="Backlash of every joint [deg]."
        ),
    ] = 0.0
    limb_mass_share: Annotated[
        float | None,
        typer.Option(
            "--limb-mass-share",
            metavar="SHARE",
            min=0.0,
            max=0.95,
            help="Fraction of the mass that is in the limbs [default: the URDF's, else 0.02].",
        ),
    ] = None
    armature: Annotated[
        str,
        typer.Option(
            "--armature",
            metavar="FACTOR|=VALUE",
            help="Factor on the rotor inertia of all joints, or =VALUE of each "
            "[kg m^2]; the robot file has the rotor inertias.",
        ),
    ] = "1"
    damping: Annotated[
        str,
        typer.Option(
            "--damping",
            metavar="FACTOR|=VALUE",
            help="Factor on the derivative gain and viscous friction of all joints, or =VALUE of "
            "each gain [N m s/rad]; the robot file has the gains.",
        ),
    ] = "1"
    limb_weights: Annotated[
        bool,
        typer.Option(
            "--limb-weights/--no-limb-weights",
            help="Whether motor commands include the weight of the links.",
        ),
    ] = True
    speed: Annotated[
        float,
        typer.Option(
            "--speed", metavar="FACTOR", min=0.01, help="Factor on the speed of the plan."
        ),
    ] = 1.0
    pictures: Annotated[
        bool,
        typer.Option("--pictures/--no-pictures", help="Whether pictures and a film are rendered."),
    ] = True
    random_backlash_deg: Annotated[
        float,
        typer.Option(
            "--random-backlash-deg",
            metavar="DEG",
            min=0.0,
            help="Largest backlash of the joints [deg], drawn for each random run.",
        ),
    ] = 0.0
    regulate: Annotated[
        Regulated | None,
        typer.Option(
            "--regulate",
            help="What the regulator of standing limbs corrects: nothing; attitude, from an "
            "inertial sensor; joints, the whole pose from joint sensors; pose, the whole true "
            "pose [default: joints; for flat feet nothing].",
            show_default=False,
        ),
    ] = None
    delay_ms: Annotated[
        float,
        typer.Option(
            "--delay-ms", metavar="MS", min=0.0, help="Delay of the regulator's corrections [ms]."
        ),
    ] = 0.0
    joint_noise_deg: Annotated[
        float,
        typer.Option(
            "--joint-noise-deg",
            metavar="DEG",
            min=0.0,
            help="Standard deviation of the joint sensors that the regulator reads [deg].",
        ),
    ] = 0.0
    closed_loop: Annotated[
        bool,
        typer.Option(
            "--closed-loop",
            help="Execute a climb or transition in closed loop: toes search their surface, limbs "
            "lift once the others hold, forces follow what is measured.",
        ),
    ] = False
    replans: Annotated[
        int | None,
        typer.Option(
            "--replans",
            metavar="N",
            min=0,
            help="Largest number of plans from measured stances, with --closed-loop [default: 2].",
        ),
    ] = None
    most_slips: Annotated[
        int | None,
        typer.Option(
            "--most-slips",
            metavar="N",
            min=0,
            help="Largest number of slips and lost contacts together that passes [default: 0; "
            "walks: 4].",
        ),
    ] = None
    allow_falls: Annotated[
        bool,
        typer.Option("--allow-falls", help="Exit code 0 also where the robot falls, for studies."),
    ] = False
    push: Annotated[
        list[str] | None,
        typer.Option(
            "--push",
            metavar="T:VX,VY,VZ",
            help="Push on a walking robot from a URDF at time T [s], as a change of velocity "
            "[m/s] of its whole mass, world frame; repeatable.",
        ),
    ] = None
    worlds: Annotated[
        int,
        typer.Option(
            "--worlds",
            metavar="N",
            min=0,
            help="Number of worlds drawn from the plan's `uncertainty`, in which falls are "
            "counted.",
        ),
    ] = 0
    engine: Annotated[
        SimulationEngine,
        typer.Option(
            "--engine",
            help="Physics engine: mujoco; statics, quasi-static steps for --worlds; drake, which "
            "plays the exported files of a climb or transition on the robot's own URDF.",
        ),
    ] = SimulationEngine.mujoco
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            metavar="FILE",
            help="URDF of the robot with its meshes [default: the one that the robot file names].",
            rich_help_panel="simulate --engine drake",
        ),
    ] = None
    sphere_toes: Annotated[
        bool,
        typer.Option(
            "--sphere-toes",
            help="Toes are spheres of the foot's radius, not the URDF's collision geometry.",
            rich_help_panel="simulate --engine drake",
        ),
    ] = False
    rare: Annotated[
        bool,
        typer.Option(
            "--rare",
            help="Probability of a fall from --worlds by multilevel splitting, for probabilities "
            "of 1e-3 to 1e-5; with --engine statics.",
        ),
    ] = False
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="W",
            min=1,
            help="Number of parallel workers of --worlds [default: --jobs].",
        ),
    ] = None
    jobs: Jobs = 1
    seed: Seed = None
    as_json: Json = False
    quiet: Quiet = False
    verbose: Verbose = False
    force: Force = False


def build_request(
    options: SimulateOptions, sweep: tuple[str, tuple[float, ...]]
) -> SimulationRequest:
    """Build the request for the simulator; raises UsageError for texts that are malformed.

    `--replans` is refused, too, without `--closed-loop`.
    """
    from climbplan.simulation.conditions import MAX_REPLANS, Conditions
    from climbplan.simulation.request import SimulationRequest

    if options.replans is not None and not options.closed_loop:
        raise UsageError(f"--replans {options.replans}: expected --closed-loop as well")
    rotors = parse_scale("--armature", options.armature)
    gains = parse_scale("--damping", options.damping)
    sweep_key, sweep_values = sweep
    return SimulationRequest(
        conditions=Conditions(
            friction=options.friction,
            payload=options.payload,
            gain=options.gain,
            limb_mass_share=options.limb_mass_share,
            armature=rotors.factor,
            armature_value=rotors.value,
            damping=gains.factor,
            damping_value=gains.value,
            backlash=math.radians(options.backlash_deg),
            limb_weights=options.limb_weights,
            speed=options.speed,
            regulator=None if options.regulate is None else options.regulate.value,
            delay=options.delay_ms / 1e3,
            joint_noise=math.radians(options.joint_noise_deg),
            noise_seed=options.seed or 0,
            closed_loop=options.closed_loop,
            max_replans=MAX_REPLANS if options.replans is None else options.replans,
        ),
        runs=options.runs,
        sweep_key=sweep_key,
        sweep_values=sweep_values,
        max_backlash=math.radians(options.random_backlash_deg),
        seed=options.seed or 0,
        jobs=options.workers or options.jobs,
        pictures=options.pictures,
        pushes=tuple(map(parse_push, options.push or ())),
        worlds=options.worlds,
        engine="statics" if options.engine is SimulationEngine.statics else "mujoco",
        rare=options.rare,
    )


def parse_push(text: str) -> tuple[float, tuple[float, float, float]]:
    """Parse TIME:VX,VY,VZ of a push into time [s] and velocity [m/s]; raises UsageError."""
    when, mark, velocity = text.partition(":")
    try:
        time, components = float(when), [float(component) for component in velocity.split(",")]
    except ValueError:
        time, components = math.nan, []
    if not mark or len(components) != 3 or not all(map(math.isfinite, (time, *components))):
        raise UsageError(f"--push {text}: expected TIME:VX,VY,VZ with numbers, such as 1.5:0,0.5,0")
    return time, (components[0], components[1], components[2])


@dataclass(frozen=True)
class ScaleOrValue:
    """A factor on the robot's data, or a value that replaces them."""

    factor: float = 1.0
    value: float | None = None


def parse_scale(option: str, text: str) -> ScaleOrValue:
    """Parse FACTOR or =VALUE; raises UsageError unless it is a number >= 0."""
    try:
        number = float(text.removeprefix("="))
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number < 0:
        raise UsageError(
            f"{option} {text}: expected a factor >= 0, such as 0.5, or = and a value, such as =0.02"
        )
    return ScaleOrValue(value=number) if text.startswith("=") else ScaleOrValue(factor=number)


def parse_sweep(text: str | None) -> tuple[str, tuple[float, ...]]:
    if text is None:
        return "", ()
    key, mark, listed = text.partition("=")
    try:
        values = [float(value) for value in listed.split(",")]
    except ValueError:
        values = []
    if not key or not mark or not values:
        raise UsageError(f"--sweep {text}: expected KEY=V1,V2,... with numbers")
    return key, tuple(values)
