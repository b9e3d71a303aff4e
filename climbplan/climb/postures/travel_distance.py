"""The straight distance to the goal against what the rounds can cover, without a solver."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Conflict, Remedy

_ROUNDING_SLACK = 1e-6  # of a step, for rounding


@dataclass(frozen=True)
class RequiredTravel:
    """The distance that body, toe or rotation has to cover, less the goal's tolerance.

    Lengths are in metres, those of the rotation in degrees.
    """

    description: str  # "the body's way to the goal"
    limb: int | None  # whose toe, None for the body
    key: str  # of `posture.steps`
    length: float
    step: float
    rounds: int  # of the spec

    @property
    def min_rounds(self) -> int:
        """Return the smallest number of rounds that covers the distance."""
        return math.ceil(self.length / self.step - _ROUNDING_SLACK)

    @property
    def conflict(self) -> Conflict:
        """Return the conflict, with changes that are necessary but perhaps not sufficient."""
        min_step = math.ceil(1e3 * self.length / self.rounds) / 1e3
        if self.key == "rotation_max_deg":
            sizes = f"{self.length:.1f} deg in steps of at most {self.step:.3g} deg"
            step_text = f"steps of {min_step:.3f} deg"
        else:
            sizes = f"{self.length:.3f} m in steps of at most {1e3 * self.step:.0f} mm"
            step_text = f"steps of {1e3 * min_step:.0f} mm"
        return Conflict(
            f"{self.rounds} round{'s' * (self.rounds != 1)}",
            (f"{self.description}, {sizes}, takes {self.min_rounds} rounds at least",),
            (
                Remedy(f"rounds >= {self.min_rounds}", "task.rounds", self.min_rounds),
                Remedy(step_text, f"posture.steps.{self.key}", min_step),
            ),
            in_words=True,
        )


def find_excessive_travel(scene: ClimbScene) -> Iterator[RequiredTravel]:
    """Return the distances of body, toes and rotation that need more rounds than the spec has."""
    start, end, spec = scene.start, scene.goal, scene.spec
    steps, goal = spec.posture.steps, spec.task.goal

    def build_travel(what: str, limb: int | None, key: str, length: float) -> RequiredTravel:
        return RequiredTravel(
            what, limb, key, length, float(getattr(steps, key)), spec.task.round_count
        )

    body = float(np.linalg.norm(end.com - start.com)) - goal.tolerance
    travels = [build_travel("the body's way to the goal", None, "com_max", body)]
    for limb, name in enumerate(scene.robot.limb_names):
        length = float(np.linalg.norm(end.toes[limb] - start.toes[limb])) - goal.tolerance
        travels.append(build_travel(f"{name}'s way to its goal", limb, "toe_max", length))
    turn = float(np.rad2deg(np.abs(end.rpy - start.rpy).max())) - goal.rotation_tolerance_deg
    travels.append(build_travel("the turn to the goal", None, "rotation_max_deg", turn))
    return (travel for travel in travels if travel.min_rounds > travel.rounds)
