"""Climb spec (`kind: climb`): what the decoupled planner of chapter 5.1 is asked to do.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from annotated_types import Ge, Gt, Le
from pydantic import BeforeValidator, Field, model_validator

from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.climb.schema.margins import Margins, MarginsSpec
from climbplan.climb.schema.stated_margins import widen_margins
from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse
from climbplan.schema.robots.gripper import GripSpec
from climbplan.schema.robots.uncertainty import UncertaintySpec
from climbplan.schema.robots.urdf.model import RobotReference
from climbplan.schema.terrain.terrain import TerrainSpec

MAX_ROUNDS = 200
MAX_PACE = 1000
MIN_PACED_RATE = 100.0  # [Hz] at which accelerations are sampled


class PostureSpec(SpecModel):
    """Where body and toes stand at the start or the end."""

    com: Vector = quantity("m", "body origin in the world")
    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw of the body", default=(0.0, 0.0, 0.0))
    toes: dict[str, Vector] = quantity(
        "m",
        "toe positions by limb; a limb left out stands on the contact region point nearest to its "
        "nominal stance, or, where its joint bounds forbid that, beside it",
        default={},
    )


class StartSpec(PostureSpec):
    """The posture to start from, given here or by another plan."""

    com: Vector = quantity("m", "body origin in the world", default=(0.0, 0.0, 0.0))
    plan: str | None = Field(
        default=None,
        min_length=1,
        description="plan file of a transition or climb, whose last posture is the start; instead "
        "of `com`, `rpy_deg` and `toes`",
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        stated_keys = self.model_fields_set - {"plan"}
        if self.plan is None and "com" not in stated_keys:
            expected = "three numbers: body origin in the world [m]"
            refuse([Fault("com", f"missing, expected {expected}, or `plan`: a plan file")])
        if self.plan is not None:
            message = "unknown beside `plan`, whose last posture is the start"
            refuse([Fault(name, message) for name in sorted(stated_keys)])
        return self


class GoalSpec(PostureSpec):
    """The posture to reach."""

    tolerance: Number = quantity(
        "m", "largest distance of any toe and of the body from the goal", default=0.02, gt=0
    )
    rotation_tolerance_deg: Number = quantity(
        "deg", "largest difference of roll, pitch and yaw from the goal", default=3.0, gt=0
    )


class PayloadSpec(SpecModel):
    """A mass fixed to the body."""

    mass: Number = quantity("kg", "payload mass", default=0.0, ge=0)
    offset: Vector = quantity("m", "its centre of mass, body frame", default=(0.0, 0.0, 0.0))


class WrenchSpec(SpecModel):
    """A constant load on the body beside all weights (wind, a hose)."""

    force: Vector = quantity("N", "force, world frame", default=(0.0, 0.0, 0.0))
    moment: Vector = quantity("N m", "moment about the body origin", default=(0.0, 0.0, 0.0))


def _parse_rounds(value: Any) -> Any:
    """Return a valid number of rounds, or "auto"; raise ValueError for others."""
    is_whole = (
        isinstance(value, int | float) and not isinstance(value, bool) and value == int(value)
    )
    if value == "auto" or (is_whole and 1 <= value <= MAX_ROUNDS):
        return value
    raise ValueError(f"expected a whole number from 1 to {MAX_ROUNDS}, or auto; got {value!r}")


Rounds = Annotated[
    Annotated[int, Ge(1), Le(MAX_ROUNDS)] | Literal["auto"], BeforeValidator(_parse_rounds)
]


class TaskSpec(SpecModel):
    """Start, goal, rounds and load."""

    rounds: Rounds = quantity(
        "",
        "number of rounds; every limb moves once a round; `auto`: as many as the way takes, "
        "planned in windows (`solver.window`)",
    )
    start: StartSpec = Field(description="posture before the first round")
    goal: GoalSpec = Field(description="posture after the last round")
    gait: tuple[str, ...] | None = Field(
        default=None,
        description="order in which limbs move in a round; the robot's order if left out",
    )
    stance: dict[str, Vector] = quantity(
        "m", "nominal toe positions by limb, body frame, where they differ from the robot's", {}
    )
    payload: PayloadSpec = PayloadSpec()
    """Mass carried on the body."""
    external_wrench: WrenchSpec = WrenchSpec()
    """Load beside all weights."""

    @property
    def round_count(self) -> int:
        """Rounds as a number; raises ValueError where the planner has not chosen it yet."""
        return int(self.rounds)


class PostureWeights(SpecModel):
    """Weights of the posture cost; zero leaves a term out of the cost."""

    goal: Number = quantity("", "W_g on the final toes' distance to the goal", default=1.0, gt=0)
    goal_com: Number = quantity("", "weight of the final body's distance", default=1.0, ge=0)
    goal_rotation: Number = quantity(
        "m^2/rad^2", "weight of the final rotation's distance to the goal", default=0.1, ge=0
    )
    com: Number = quantity("", "W_COM on body steps", default=0.01, gt=0)
    toe: Number = quantity("", "W_s on toe steps", default=0.01, gt=0)
    rotation: Number = quantity("m^2/rad^2", "W_ROT on rotation steps", default=1e-3, gt=0)
    force: Number = quantity(
        "m^2",
        "weight of the squared contact forces, in weights of the robot (coupled methods only)",
        default=0.0,
        ge=0,
    )


class PostureSteps(SpecModel):
    """Bounds on what may change from one round to the next."""

    com_max: Number = quantity("m", "largest body step", default=0.15, gt=0)
    toe_max: Number = quantity("m", "largest toe step", default=0.24, gt=0)
    rotation_max_deg: Number = quantity("deg", "largest turn about each axis", default=10.0, gt=0)
    com_min: Number = quantity("m", "smallest body step (`nlp` only)", default=0.0, ge=0)
    toe_min: Number = quantity("m", "smallest toe step (`nlp` only)", default=0.0, ge=0)
    com_shift_max: Number = quantity(
        "m",
        "how far the body may leave its straight way, level, to stand over the limbs that stay "
        "before one is lifted, by as little as forces with their margins ask for; 0: it keeps to "
        "its way, as between walls (on level ground four legs ask for about half their spacing)",
        default=0.0,
        ge=0,
        le=2,
    )

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        refuse(
            [
                Fault(
                    f"{name}_min", f"expected less than {name}_max {max_step:g}, got {min_step:g}"
                )
                for name, min_step, max_step in (
                    ("com", self.com_min, self.com_max),
                    ("toe", self.toe_min, self.toe_max),
                )
                if min_step >= max_step
            ]
        )
        return self


class PosturePlannerSpec(SpecModel):
    """The posture planner (first stage)."""

    weights: PostureWeights = PostureWeights()
    """Cost weights."""
    steps: PostureSteps = PostureSteps()
    """Step bounds."""
    rotation_limit_deg: Number = quantity(
        "deg",
        "largest roll and pitch of the body, and yaw away from the start's (free in a tube); all "
        "away from the start's where the body starts further from level than this",
        default=20.0,
        gt=0,
        le=180,
    )
    check_reach_during_round: bool = Field(
        default=True,
        description="also keep every toe in its workspace while the body moves within a round",
    )
    stance_workspace: bool = Field(
        default=True, description="also keep every toe near its nominal stance (second ball)"
    )
    limb_clearance: Number = quantity(
        "m",
        "distance that limbs, as thick as limb_radius, are planned to keep from obstacles while "
        "they stand; no link ever touches one",
        default=0.005,
        ge=0,
    )
    body_clearance: Number = quantity(
        "m", "distance the body hull keeps from obstacles and walls", default=0.02, ge=0
    )
    min_load: Number = quantity(
        "weight",
        "upward force of every limb at the end of a round at least, in weights of the robot "
        "(coupled methods only): toes then keep off places that hold nothing",
        default=0.04,
        ge=0,
        lt=1,
    )


def _parse_pace(value: Any) -> Any:
    """Return a valid pace, a factor or "fastest"; raise ValueError for others."""
    is_factor = isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    if value == "fastest" or (is_factor and value <= MAX_PACE):
        return value
    raise ValueError(
        f"expected a number greater than 0 and at most {MAX_PACE}, or fastest; got {value!r}"
    )


Pace = Annotated[
    Annotated[float, Gt(0), Le(MAX_PACE)] | Literal["fastest"], BeforeValidator(_parse_pace)
]


class TrajectorySpec(SpecModel):
    """The playable motion between the planned instants."""

    speed: Number = quantity(
        "m/s",
        "mean climbing speed, less where joint speeds or the body's inertia ask for it",
        default=0.2 / 60,
        gt=0,
        le=1,
    )
    pace: Pace | None = quantity(
        "",
        "time the motion by the dynamics of its links, with contact forces and torques that move "
        "them: a factor on `speed`, less where joint speeds, torques or friction ask for it, or "
        "`fastest`; sampled at 100 Hz at least. Left out: quasi-static",
        default=None,
    )
    rate: Number = quantity("Hz", "sample rate", default=20.0, gt=0, le=1000)
    swing_clearance: Number = quantity(
        "m", "distance a toe is lifted along the normal", default=0.05, gt=0
    )


COUPLED_METHODS = (
    "coupled",
    "coupled-modes",
    "coupled-mccormick",
    "coupled-nlp",
    "coupled-minlp-scip",
)
CONVEX_METHODS = ("micp", "sl1-relaxation")  # of flat regions and rotations to first order


class SolverSpec(SpecModel):
    """Which method and solver, and when to stop."""

    method: Literal[
        "auto",
        "micp",
        "nlp",
        "coupled",
        "coupled-modes",
        "coupled-mccormick",
        "coupled-nlp",
        "coupled-minlp-scip",
        "sl1-relaxation",
        "contact-search",
    ] = Field(
        default="auto",
        description="`auto`: `micp` first, then what its failure suggests: other methods, and "
        "other choices of what the spec leaves open (lift, gait, the goal's angles); with "
        "`task.rounds: auto` on ground `contact-search` first, then windows. `contact-search`: "
        "footholds one after the other along a path of the body over the ground, for long ways on "
        "stairs, rubble and scans with hundreds of regions. `micp`: "
        "globally optimal postures by a mixed-integer convex program, small rotations; `nlp`: "
        "exact rotations, curved terrain. Postures and contact forces together: `coupled`, "
        "moments by a learned envelope, then exact forces; `coupled-modes`, one of several "
        "envelopes in each round; `coupled-mccormick`, moments by piecewise McCormick envelopes, "
        "with a bound; `coupled-nlp`, one nonlinear program; `coupled-minlp-scip`, SCIP on the "
        "whole statement, for a round or two. `sl1-relaxation`: the program of `micp`, regions "
        "chosen by an L1 relaxation and rounding instead of a search, without a bound",
    )
    envelopes: tuple[str, ...] = Field(
        default=(),
        description="envelopes of the coupled methods: `ground3`, `wall3`, `wall5` (shipped; "
        "`wall5:genetic` for another fit than clustering), `expert`, `expert-ground`, or the path "
        "of an envelopes.h5; left out: by the regions' normals, for `coupled-modes` ground3 and "
        "wall5 (of robots without their limbs the experts'), for `coupled-mccormick` none, "
        "without which its bound holds for the exact problem",
    )
    pieces: Count = quantity(
        "", "pieces of each toe coordinate's range (`coupled-mccormick`)", default=4, ge=1, le=64
    )
    mip_solver: Literal["highs", "gurobi"] = Field(
        default="highs", description="solver of the mixed-integer program (`coupled-mccormick`)"
    )
    posture_solver: Literal["branch-and-bound", "scip", "gurobi"] = Field(
        default="branch-and-bound", description="solver of the posture program (`micp`)"
    )
    force_solver: Literal["daqp", "clarabel", "osqp"] = Field(
        default="daqp",
        description="`daqp`: inscribed pyramid, fastest; `clarabel`: exact cone; `osqp`: pyramid",
    )
    gap: Number = quantity("", "relative optimality gap to prove", default=1e-4, gt=0, lt=1)
    time_limit: Number = quantity("s", "time limit of the posture planner", default=120.0, gt=0)
    window: Count | None = quantity(
        "",
        "rounds planned at once; half of them are kept before the next window begins. Left out: "
        "all at once, or 4 where `task.rounds` is `auto`. Methods `micp`, `nlp` and `auto`, which "
        "takes the first of the two that has a plan for a window",
        default=None,
        ge=2,
        le=200,
    )
    starts: Count = quantity(
        "",
        "starts of `nlp`: the convex plan if there is one, the straight way, then random ways",
        default=4,
        ge=1,
        le=1000,
    )


class StudySpec(SpecModel):
    """A grid of runs of the same spec with other values (feasible regions)."""

    grid: dict[str, tuple[Number, ...]] = Field(
        description="dotted key -> values; one or two keys, the plan itself is made at the spec's "
        "own values"
    )

    @model_validator(mode="after")
    def _one_or_two(self) -> Self:
        faults = [
            Fault("grid", f"{key}: expected a list of at least one number, got an empty list")
            for key, values in self.grid.items()
            if not values
        ]
        if len(self.grid) not in (1, 2):
            faults.append(Fault("grid", f"expected one or two dotted keys, got {len(self.grid)}"))
        refuse(faults)
        return self


class ClimbSpec(SpecModel):
    """Climb between walls, in tubes, or over steps."""

    kind: Literal["climb"] = Field(description="always `climb`")
    title: str = Field(default="", description="one line for reports")
    robot: RobotReference = Field(
        description="built-in robot (`silvia`), path of a robot YAML file, or a URDF with its legs "
        "(`{urdf: PATH, legs: {NAME: {toe: LINK}}}`)"
    )
    forward: Literal["y"] = Field(
        default="y",
        description="world axis that points forward: always `y`, with x to the right; walks may "
        "have it, too",
    )
    terrain: TerrainSpec
    """Where toes may stand and what must not be touched."""
    task: TaskSpec
    """Start, goal, rounds and load."""
    posture: PosturePlannerSpec = PosturePlannerSpec()
    """The posture planner."""
    force: ForcePlannerSpec = ForcePlannerSpec()
    """The force planner."""
    margins: Margins = Field(
        default=MarginsSpec(),
        description="what a plan keeps in hand, as far as terrain and motors allow it, so that it "
        "stands in physics; what `uncertainty` states may ask for more; `none`: bounds of `force` "
        "alone, as published",
    )
    gripper: GripSpec = GripSpec()
    """How grippers are used, by robots that have them."""
    trajectory: TrajectorySpec = TrajectorySpec()
    """The playable motion."""
    uncertainty: UncertaintySpec = UncertaintySpec()
    """What is uncertain of robot and terrain, for simulated worlds."""
    risk: Number | None = quantity(
        "",
        "largest probability of a fall: the plan is judged in worlds of `uncertainty` and planned "
        "again where it fell; left out, nothing is promised",
        default=None,
        gt=0,
        lt=1,
    )
    closed_loop: bool = Field(
        default=False,
        description="whether falls for `risk` are counted in closed-loop execution in MuJoCo, not "
        "by quasi-static steps; takes seconds to minutes a world",
    )
    solver: SolverSpec = SolverSpec()
    """Methods, solvers and limits."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)
    study: StudySpec | None = Field(default=None, description="grid of runs beside the plan")

    @model_validator(mode="after")
    def _margins_for_uncertainty(self) -> Self:
        has_grips = self.terrain.gripped
        safety_friction = self.force.safety_friction if has_grips else 1.0
        margins = widen_margins(self.margins, self.uncertainty, safety_friction)
        if margins is not self.margins:
            object.__setattr__(self, "margins", margins)
        return self
