"""What goes into a program beside its phases, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.limms.attempts.work import Work
from climbplan.limms.scene.statement import Trace


@dataclass(frozen=True)
class Cut:
    """A point of a limb that has to stay on one side of a plane, found by looking at an answer.

    point: 0 to 7 of the module; normal . point >= offset at one knot, the point in the frame of the
    box where the plane moves with it.
    """

    phase: int
    knot: int
    limb: int
    point: int
    normal: Array
    offset: float
    moves_with_box: bool


@dataclass(frozen=True)
class Outcome:
    """Whether a program was solved, and its answer."""

    solved: bool
    message: str
    traces: tuple[Trace, ...]
    violation: float
    objective: float
    variables: int
    constraints: int
    work: Work  # of all programs that were solved for it
    optimal: bool = False  # solved, and the solver says that nothing near is better


@dataclass(frozen=True)
class Ends:
    """What holds at the two ends of the motion."""

    start: Array  # (D,) placements [m, rad]
    goal: Array  # (D,)
    arrival_speed: float  # [m/s]
