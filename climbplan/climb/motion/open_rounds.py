"""Motions whose number of rounds is found by the search, to the goal or part of the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from climbplan.climb.motion.motion import SupportedMotion
from climbplan.climb.scene.climb_scene import ClimbScene, ClimbStance
from climbplan.climb.schema.loading import LoadedClimb


@dataclass(frozen=True)
class OpenRoundsMotion:
    """A motion, and the scene with the rounds that it took and the toes of the goal it chose."""

    scene: ClimbScene
    supported: SupportedMotion


@dataclass(frozen=True)
class PartialClimb:
    """What a search found before it ended: rounds up to a stance on the way.

    It is the plan of a nearer goal, and is checked as such.
    """

    end: ClimbStance  # of the last round found
    num_rounds: int
    covered: float  # [m] of the way
    length: float  # [m] of the way to the goal
    build: Callable[[ClimbScene], OpenRoundsMotion]  # the motion in the scene with that goal
    loaded: LoadedClimb | None = None  # the spec that was planned
