"""What the specs of climbs and transitions have in common, as their shared stages see it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol, Self

from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.climb.schema.margins import Margins
from climbplan.climb.schema.model import (
    GoalSpec,
    PayloadSpec,
    PostureSpec,
    PostureWeights,
    TrajectorySpec,
    WrenchSpec,
)
from climbplan.schema.terrain.terrain import TerrainSpec


class MotionTask(Protocol):
    """Start, goal and load."""

    @property
    def rounds(self) -> int | Literal["auto"]:
        """Number of rounds, or that it is open."""

    @property
    def start(self) -> PostureSpec:
        """Posture before the first round."""

    @property
    def goal(self) -> GoalSpec:
        """Posture after the last round."""

    @property
    def payload(self) -> PayloadSpec:
        """Mass carried on the body."""

    @property
    def external_wrench(self) -> WrenchSpec:
        """Load beside all weights."""


class MotionSteps(Protocol):
    """Bounds on what may change in a round."""

    @property
    def com_max(self) -> float:
        """Largest body step [m]."""

    @property
    def com_min(self) -> float:
        """Smallest body step [m]."""

    @property
    def toe_max(self) -> float:
        """Largest toe step [m]."""

    @property
    def toe_min(self) -> float:
        """Smallest toe step [m]."""

    @property
    def rotation_max_deg(self) -> float:
        """Largest turn about each axis [deg]."""

    @property
    def com_shift_max(self) -> float:
        """Largest level shift of the body off its straight way before a lift [m]."""


class MotionPosture(Protocol):
    """Cost and bounds of postures."""

    @property
    def weights(self) -> PostureWeights:
        """Cost weights."""

    @property
    def steps(self) -> MotionSteps:
        """Step bounds."""

    @property
    def rotation_limit_deg(self) -> float:
        """Largest rotation of the body [deg]."""

    @property
    def body_clearance(self) -> float:
        """Distance the body hull keeps from solids [m]."""


class ForceSolver(Protocol):
    """Solver choices that the shared stages look at."""

    @property
    def force_solver(self) -> str:
        """Solver of the force problems."""


class MotionSpec(Protocol):
    """A climb or a transition."""

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """The spec with other values of some keys."""

    @property
    def kind(self) -> str:
        """`climb` or `transition`."""

    @property
    def terrain(self) -> TerrainSpec:
        """The terrain, which has the surfaces for toes."""

    @property
    def task(self) -> MotionTask:
        """Start, goal and load."""

    @property
    def posture(self) -> MotionPosture:
        """Cost and bounds of postures."""

    @property
    def force(self) -> ForcePlannerSpec:
        """The force planner."""

    @property
    def margins(self) -> Margins:
        """Reserves that forces keep where they can."""

    @property
    def trajectory(self) -> TrajectorySpec:
        """The playable motion."""

    @property
    def solver(self) -> ForceSolver:
        """Solver choices."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""
