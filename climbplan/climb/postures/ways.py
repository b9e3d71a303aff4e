"""The straight way to the goal against what the rounds can cover, which needs no solver."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Conflict, Remedy

_SLACK = 1e-6  # of a step, for rounding


@dataclass(frozen=True)
class Way:
    """What has to be covered of one thing, less the goal's tolerance, in steps of at most `step`.

    In m, the turn in degrees.
    """

    what: str  # "the body's way to the goal"
    limb: int | None  # whose toe, None for the body
    key: str  # of `posture.steps`
    length: float
    step: float
    rounds: int  # of the spec

    @property
    def needed(self) -> int:
        """Rounds that it takes at least."""
        return math.ceil(self.length / self.step - _SLACK)

    @property
    def conflict(self) -> Conflict:
        """In words, with changes that are needed at least."""
        least = math.ceil(1e3 * self.length / self.rounds) / 1e3
        if self.key == "rotation_max_deg":
            sizes = f"{self.length:.1f} deg in steps of at most {self.step:.3g} deg"
            larger = f"steps of {least:.3f} deg"
        else:
            sizes = f"{self.length:.3f} m in steps of at most {1e3 * self.step:.0f} mm"
            larger = f"steps of {1e3 * least:.0f} mm"
        return Conflict(
            f"{self.rounds} round{'s' * (self.rounds != 1)}",
            (f"{self.what}, {sizes}, takes {self.needed} rounds at least",),
            (
                Remedy(f"rounds >= {self.needed}", "task.rounds", self.needed),
                Remedy(larger, f"posture.steps.{self.key}", least),
            ),
            in_words=True,
        )


def ways_too_long(scene: ClimbScene) -> Iterator[Way]:
    """Those of body, toes and turn that take more rounds than the spec has."""
    start, end, spec = scene.start, scene.goal, scene.spec
    steps, goal = spec.posture.steps, spec.task.goal

    def way(what: str, limb: int | None, key: str, length: float) -> Way:
        return Way(what, limb, key, length, float(getattr(steps, key)), spec.task.round_count)

    body = float(np.linalg.norm(end.com - start.com)) - goal.tolerance
    ways = [way("the body's way to the goal", None, "com_max", body)]
    for limb, name in enumerate(scene.robot.limb_names):
        length = float(np.linalg.norm(end.toes[limb] - start.toes[limb])) - goal.tolerance
        ways.append(way(f"{name}'s way to its goal", limb, "toe_max", length))
    turn = float(np.rad2deg(np.abs(end.rpy - start.rpy).max())) - goal.rotation_tolerance_deg
    ways.append(way("the turn to the goal", None, "rotation_max_deg", turn))
    return (one for one in ways if one.needed > one.rounds)
