"""Data of a quadruped's program: phases, cuts and solutions.

Modules have no mass and the box does not turn, so the joint angles of a standing leg are closed
functions of the box relative to its foot. The variables are the path of the box, footholds, forces,
durations, and joint angles of swing feet only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from climbplan.arrays import Array

SPANS = 4  # of the joint splines of a swing foot
CONTROLS = SPANS + 2  # their control points


@dataclass(frozen=True)
class LegPhase:
    """A phase of constant contacts: swing feet, and bounds on the centre of the box."""

    name: str
    lower: Array  # (3,) lower bound of the centre of the box [m]
    upper: Array  # (3,)
    intervals: int
    shortest: float  # [s]
    longest: float  # [s]
    swing: tuple[int, ...] = ()  # limbs whose feet are in the air
    patches: dict[int, int] = field(default_factory=dict)  # limb -> patch it stands on afterwards


@dataclass(frozen=True)
class LegTrajectory:
    """The trajectory of one phase at its knots (K + 1) with L limbs."""

    phase: LegPhase
    duration: float  # [s]
    position: Array  # (K + 1, 3) of the box [m]
    velocity: Array  # (K + 1, 3) [m/s]
    acceleration: Array  # (K + 1, 3) [m/s^2], linear between knots
    before: Array  # (L, 3) footholds when it begins [m]
    after: Array  # (L, 3) footholds when it ends [m]
    controls: Array  # (L, CONTROLS, 6) joint splines of feet in the air [rad]
    force: Array  # (K + 1, L, 3) at the feet [N], linear between knots


@dataclass(frozen=True)
class LegCut:
    """A cutting plane for a point of a leg at a fraction of a phase's time.

    The constraint is normal . (point - move * box centre) >= offset for points 0 to 7 of the
    module. Point 0 is one radius up from the foot, where the axis of its link ends.
    """

    phase: int
    time_fraction: float
    limb: int
    point: int
    normal: Array  # (3,)
    offset: float  # [m]
    moves_with_box: bool


@dataclass(frozen=True)
class BoxCut:
    """A cutting plane at a fraction of a phase's time: normal . box centre >= offset."""

    phase: int
    time_fraction: float
    normal: Array  # (3,)
    offset: float  # [m]


@dataclass(frozen=True)
class LegSample:
    """A fraction of a phase's time at which ranges and speeds of a standing leg must hold."""

    phase: int
    time_fraction: float
    limb: int


@dataclass(frozen=True)
class LegBoundary:
    """Boundary conditions: rest at both ends, and first footholds if given."""

    start: Array  # (3,) [m]
    goal: Array  # (3,) [m]
    feet: Array | None = None  # (L, 3) [m]; None: free on their patches
