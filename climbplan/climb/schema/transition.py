"""Transition spec (`kind: transition`): from standing on the ground to bracing between walls.

Chapter 5.3: which limbs move together, round by round, where to, and with what forces.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import re
from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.climb.schema.margins import Margins, MarginsSpec
from climbplan.climb.schema.model import (
    GoalSpec,
    PayloadSpec,
    PosturePlannerSpec,
    PostureSpec,
    PostureWeights,
    TrajectorySpec,
    WrenchSpec,
)
from climbplan.climb.schema.stated_margins import widen_margins
from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse
from climbplan.schema.robots.uncertainty import UncertaintySpec
from climbplan.schema.robots.urdf.model import RobotReference
from climbplan.schema.terrain.terrain import TerrainSpec

_SEQUENCE = re.compile(r"[1-9]\d?(-[1-9]\d?)*")


class TransitionTaskSpec(SpecModel):
    """Start, goal, rounds and load."""

    rounds: Count = quantity("", "number of rounds; some limbs move together in each", ge=1, le=8)
    sequence: str | None = Field(
        default=None,
        description="how many limbs move in each round (`3-1-2-2`), or which "
        "(`LF LR RM | RF RR LM`); any that works if left out",
    )
    start: PostureSpec = Field(description="posture before the first round")
    goal: GoalSpec = Field(description="posture after the last round")
    stance: dict[str, Vector] = quantity(
        "m", "nominal toe positions by limb, body frame, where they differ from the robot's", {}
    )
    step_max: dict[str, Number] = quantity(
        "m", "largest toe step of single limbs, where shorter than `posture.steps.toe_max`", {}
    )
    min_supporting_limbs: Count = quantity(
        "", "least number of limbs that support the body", 3, ge=2
    )
    payload: PayloadSpec = PayloadSpec()
    """Mass carried on the body."""
    external_wrench: WrenchSpec = WrenchSpec()
    """Load beside all weights."""

    @model_validator(mode="after")
    def _counts(self) -> Self:
        if self.sequence is None:
            return self
        if not self.limbs and not _SEQUENCE.fullmatch(self.sequence):
            expected = "expected counts of limbs such as `3-3`, or limbs such as `LF LR | RM`"
            refuse([Fault("sequence", f"{expected}, got {self.sequence!r}")])
        if any(len(set(names)) < max(len(names), 1) for names in self.limbs):
            expected = "expected limbs in every round, each once"
            refuse([Fault("sequence", f"{expected}, got {self.sequence!r}")])
        if len(self.moving) != self.rounds:
            count = f"{self.sequence!r} has {len(self.moving)} rounds"
            refuse([Fault("sequence", f"{count}, expected `rounds`: {self.rounds}")])
        return self

    @property
    def limbs(self) -> tuple[tuple[str, ...], ...]:
        """Return which limbs move in each round; empty if the sequence does not name them."""
        if self.sequence is None or not (set(self.sequence) - set("0123456789- ")):
            return ()
        return tuple(tuple(round_limbs.split()) for round_limbs in self.sequence.split("|"))

    @property
    def moving(self) -> tuple[int, ...]:
        """Return how many limbs move in each round; empty if the sequence is not stated."""
        if self.limbs:
            return tuple(len(names) for names in self.limbs)
        return tuple(int(n) for n in self.sequence.split("-")) if self.sequence else ()


class TransitionWeights(PostureWeights):
    """Weights of the transition's cost."""

    effort: Number = quantity(
        "", "weight of 1 / S_tau at every lift, the share of the torque limits in use", 0.002, ge=0
    )


class TransitionSteps(SpecModel):
    """Bounds on what may change from one round to the next."""

    com_max: Number = quantity("m", "largest body step", default=0.25, gt=0)
    toe_max: Number = quantity("m", "largest toe step", default=0.8, gt=0)
    rotation_max_deg: Number = quantity("deg", "largest turn about each axis", default=15.0, gt=0)
    com_shift_max: Number = quantity(
        "m",
        "largest level shift of the body off its start before the first limbs lift, so that the "
        "others hold it: a quadruped on ground has to stand over three legs. In a `climb` that "
        "follows, before each lift",
        default=0.0,
        ge=0,
    )

    @property
    def com_min(self) -> float:
        """Smallest body step [m]: the body may rest."""
        return 0.0

    @property
    def toe_min(self) -> float:
        """Smallest toe step [m]: toes may rest."""
        return 0.0


class TransitionPostureSpec(SpecModel):
    """Body poses and footholds."""

    weights: TransitionWeights = TransitionWeights()
    """Cost weights."""
    steps: TransitionSteps = TransitionSteps()
    """Step bounds."""
    rotation_limit_deg: Number = quantity(
        "deg", "largest roll, pitch and turn of the body", default=20.0, gt=0, le=90
    )
    body_clearance: Number = quantity(
        "m", "distance the body hull keeps from obstacles, ground and walls", default=0.02, ge=0
    )


class TransitionForceSpec(ForcePlannerSpec):
    """Contact forces and their safety factors."""

    safety_friction: Number = quantity("", "S_mu, friction safety factor", default=1.1, ge=1)
    safety_torque: Number = quantity("", "least S_tau, torque safety factor", default=1.8, ge=1)


class SearchSpec(SpecModel):
    """What the search over stance sets looks at between start and goal."""

    heights: Count = quantity(
        "", "body poses tried on the straight way to the goal", 5, ge=2, le=20
    )
    lateral_offset: Number = quantity(
        "m", "how far beside that way further poses lie", default=0.06, ge=0
    )
    min_load: Number = quantity(
        "",
        "share of the weight that every supporting limb presses with at least; at 0 a limb may "
        "touch without load, and the body balance on the edge between two others",
        default=0.02,
        ge=0,
        lt=1,
    )
    between: Literal["none", "boxes", "any"] = Field(
        default="boxes",
        description="footholds beside start and goal: `none`, on `boxes`, or on `any` surface",
    )
    max_sequences: Count = quantity("", "sequences listed at most", default=500, ge=1, le=10000)
    rank: Literal["cost", "torque", "friction"] = Field(
        default="cost",
        description="which sequence comes first: of least cost, or of the largest S_tau or S_mu",
    )
    max_planned: Count = quantity("", "sequences planned at most until one holds", default=12, ge=1)


class TransitionSolverSpec(SpecModel):
    """Which method, and when to stop."""

    method: Literal["auto", "stance-search", "mpcc"] = Field(
        default="auto",
        description="`auto`: `stance-search`, and `mpcc` where that finds nothing and the "
        "sequence is left open; `stance-search`: search over stance sets, then a nonlinear program "
        "with the sequence fixed; `mpcc`: one nonlinear program that also finds the "
        "sequence",
    )
    force_solver: Literal["daqp", "clarabel", "osqp"] = Field(
        default="daqp",
        description="`daqp`: inscribed pyramid, fastest; `clarabel`: exact cone; `osqp`: pyramid",
    )
    starts: Count = quantity("", "starts of `mpcc`", default=5, ge=1, le=1000)
    time_limit: Number = quantity("s", "time limit", default=120.0, gt=0)


class ClimbAfterSpec(SpecModel):
    """A climb that goes on where the transition ends, in the same plan."""

    rounds: Count = quantity("", "number of rounds; every limb moves once a round", ge=1, le=200)
    goal: GoalSpec = Field(description="posture after the last round")
    gait: tuple[str, ...] | None = Field(
        default=None,
        description="order in which limbs move in a round; the robot's order if left out",
    )
    posture: PosturePlannerSpec = PosturePlannerSpec()
    """The posture planner of the climb."""


class TransitionSpec(SpecModel):
    """From the ground to the wall."""

    kind: Literal["transition"] = Field(description="always `transition`")
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
    task: TransitionTaskSpec
    """Start, goal, rounds and load."""
    posture: TransitionPostureSpec = TransitionPostureSpec()
    """Body poses and footholds."""
    force: TransitionForceSpec = TransitionForceSpec()
    """Contact forces and their safety factors."""
    margins: Margins = Field(
        default=MarginsSpec(),
        description="what a plan keeps in hand, as far as terrain and motors allow it, so that it "
        "stands in physics; what `uncertainty` states may ask for more; `none`: bounds of `force` "
        "alone, as published",
    )
    search: SearchSpec = SearchSpec()
    """The search over stance sets."""
    climb: ClimbAfterSpec | None = Field(
        default=None, description="a climb that goes on where the transition ends"
    )
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
    solver: TransitionSolverSpec = TransitionSolverSpec()
    """Method and limits."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _margins_for_uncertainty(self) -> Self:
        margins = widen_margins(self.margins, self.uncertainty)
        if margins is not self.margins:
            object.__setattr__(self, "margins", margins)
        return self

    @property
    def last_goal(self) -> GoalSpec:
        """Return the goal of the whole plan."""
        return self.task.goal if self.climb is None else self.climb.goal

    @property
    def all_rounds(self) -> int:
        """Return the number of rounds of the whole plan."""
        return self.task.rounds + (0 if self.climb is None else self.climb.rounds)
