"""What became of a spec that `new robot` proposes: its plan, and worlds that it stands in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import WorldSample
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.prepared_robot import Proposal

NONE_KEPT = 0.01  # of its margins: plans that keep no more may fall, motors at their limits
STANDING = 0.98  # fraction of worlds in which a plan stands that nothing better is looked for

SampleWorlds = Callable[[ClimbPlan], WorldSample | None]
"""Counts falls in worlds of a plan's uncertainty; None for robots that no engine knows."""


@dataclass(frozen=True)
class Outcome:
    """What became of a spec."""

    what: str  # "walks on ground"
    plan: ClimbPlan | None  # that is verified
    why: str  # there is none
    text: str = ""  # of the spec; empty where there is none
    brace: Posture | None = None  # between its walls
    bent: Proposal | None = None  # the robot, where its file is another than as it stands
    sample: WorldSample | None = None  # of worlds, where they were played
    implausible: tuple[str, ...] = ()  # deflections that no such robot has
    needed: str = ""  # what would have it stand in enough worlds

    @property
    def share(self) -> float:
        """Of its margins that the plan keeps at its worst instant; -infinity without a plan.

        Below zero where a toe keeps hold though its command lies outside its surface, say.
        """
        if self.plan is None:
            return -np.inf
        kept = self.plan.forces.margin_share
        return 1.0 if kept is None else float(kept.min())

    @property
    def standing(self) -> float:
        """Fraction of the sampled worlds in which the plan stands; 1 where none were played."""
        if self.plan is None or self.sample is None:
            return 0.0 if self.plan is None else 1.0
        return 1.0 - self.sample.falls / self.sample.worlds

    @property
    def rank(self) -> tuple[bool, bool, float, float]:
        """Larger for better outcomes: a plan that may be used, worlds, then margins."""
        return self.plan is not None, not self.implausible, self.standing, self.share

    def good_enough(self, share: float) -> bool:
        """Whether nothing better is looked for; share: of its margins, where no worlds tell."""
        if self.plan is None or self.implausible:
            return False
        return self.share >= share if self.sample is None else self.standing >= STANDING

    def __str__(self) -> str:
        if self.plan is None:
            return f"{self.what}: {self.why}"
        if self.implausible:
            return f"{self.what}: do not use: implausible: {self.implausible[0]}"
        if self.sample is not None:
            worlds = f"{self.sample.stands} of its uncertainty ({self.sample.interval})"
            if self.sample.enough:
                return f"{self.what}: verified, {worlds}"
            first = f"; most frequent: {self.sample.causes[0]}" if self.sample.causes else ""
            needed = f"; needed: {self.needed}" if self.needed else ""
            return f"{self.what}: verified, but {worlds}{first}{needed}"
        if self.share > NONE_KEPT:
            return f"{self.what}: verified"
        worst = "; ".join(self.plan.forces.notes)
        return f"{self.what}: verified, but may fall: {self.share:.0%} of its margins ({worst})"
