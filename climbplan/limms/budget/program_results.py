"""Data of programs besides their phases, and their outcomes."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.limms.budget.solver_work import Work
from climbplan.limms.scene.phases import PhaseTrajectory


@dataclass(frozen=True)
class CollisionCut:
    """A cutting plane: a point of a limb stays on one side of a plane, found from a collision.

    The constraint is normal . point >= offset at one knot, for points 0 to 7 of the module. The
    point is in the frame of the box where the plane moves with it.
    """

    phase: int
    knot: int
    limb: int
    point: int
    normal: Array
    offset: float
    moves_with_box: bool


@dataclass(frozen=True)
class ProgramOutcome:
    """The solution of a program, and whether it was solved."""

    solved: bool
    message: str
    traces: tuple[PhaseTrajectory, ...]
    violation: float
    objective: float
    variables: int
    constraints: int
    work: Work  # of all programs solved for this outcome
    is_optimal: bool = False  # solved, and the solver reports local optimality


@dataclass(frozen=True)
class BoundaryConditions:
    """Boundary conditions at the two ends of the motion."""

    start: Array  # (D,) placements [m, rad]
    goal: Array  # (D,)
    arrival_speed: float  # [m/s]
