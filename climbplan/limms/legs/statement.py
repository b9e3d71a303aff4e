"""What a quadruped's program is made of: phases, cuts, and an answer.

Modules have no mass and the box does not turn, so that a standing leg's joint angles follow in
closed form from where the box is over its foot. A program therefore needs no joint angles but those
of feet in the air: it has the box's path, footholds, forces and durations.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from climbplan.arrays import Array

SPANS = 4  # of the joint splines of a foot in the air
CONTROLS = SPANS + 2  # their control points


@dataclass(frozen=True)
class LegPhase:
    """Constant contacts: which feet are in the air, where the box's centre may be."""

    name: str
    lower: Array  # (3,) least centre of the box [m]
    upper: Array  # (3,)
    intervals: int
    shortest: float  # [s]
    longest: float  # [s]
    swing: tuple[int, ...] = ()  # limbs whose feet are in the air
    patches: dict[int, int] = field(default_factory=dict)  # limb -> patch it stands on afterwards


@dataclass(frozen=True)
class LegTrace:
    """An answer for one phase at its knots (K + 1); L limbs."""

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
    """A point of a leg that has to stay on one side of a plane at a share of a phase's time.

    point: 0 to 7 of the module, but 0 is one radius up from the foot, where its link's axis ends.
    normal . (point - move * box centre) >= offset.
    """

    phase: int
    share: float
    limb: int
    point: int
    normal: Array  # (3,)
    offset: float  # [m]
    moves_with_box: bool


@dataclass(frozen=True)
class BoxCut:
    """normal . box centre >= offset at a share of a phase's time."""

    phase: int
    share: float
    normal: Array  # (3,)
    offset: float  # [m]


@dataclass(frozen=True)
class LegSample:
    """A share of a phase's time at which a standing leg's ranges and speeds have to hold."""

    phase: int
    share: float
    limb: int


@dataclass(frozen=True)
class LegEnds:
    """What holds at both ends: at rest there, and the first footholds if they are given."""

    start: Array  # (3,) [m]
    goal: Array  # (3,) [m]
    feet: Array | None = None  # (L, 3) [m]; None: free on their patches
