"""The outcome of a spec that `new robot` proposes: its plan, and the worlds without a fall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import WorldSample
from climbplan.robots.urdf.proposal.postures import LeggedPosture
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal

NEGLIGIBLE_MARGIN = 0.01  # fraction of margins: plans with no more may fall, motors at their limits
TARGET_STANDING = 0.95  # fraction of worlds without a fall that ends the search for better plans

SampleWorlds = Callable[[ClimbPlan], WorldSample | None]
"""Counts falls in worlds of a plan's uncertainty; None for robots that no engine knows."""


@dataclass(frozen=True)
class SpecOutcome:
    """The outcome of a spec."""

    what: str  # "walks on ground"
    plan: ClimbPlan | None  # that is verified
    why: str  # there is none
    text: str = ""  # of the spec; empty where there is none
    brace: LeggedPosture | None = None  # between its walls
    proposal: RobotProposal | None = None  # the robot, where its file is another than as it stands
    sample: WorldSample | None = None  # of worlds, where they were played
    implausible: tuple[str, ...] = ()  # deflections that no such robot has
    needed: str = ""  # what would have it stand in enough worlds

    @property
    def margin_fraction(self) -> float:
        """Fraction of its margins that the plan keeps at its worst instant; -inf without a plan.

        It is negative where, for instance, a toe keeps contact with its command off its surface.
        """
        if self.plan is None:
            return -np.inf
        margin_fractions = self.plan.forces.margin_share
        return 1.0 if margin_fractions is None else float(margin_fractions.min())

    @property
    def standing(self) -> float:
        """Fraction of the sampled worlds without a fall; 1 if none were sampled."""
        if self.plan is None or self.sample is None:
            return 0.0 if self.plan is None else 1.0
        return 1.0 - self.sample.falls / self.sample.worlds

    @property
    def rank(self) -> tuple[bool, bool, float, float]:
        """Key that is larger for better outcomes: a usable plan, then worlds, then margins."""
        return self.plan is not None, not self.implausible, self.standing, self.margin_fraction

    def is_good_enough(
        self, min_margin_fraction: float, min_standing: float = TARGET_STANDING
    ) -> bool:
        """Return whether no better plan is needed.

        Args:
            min_margin_fraction: Fraction of margins that counts where no worlds were sampled.
            min_standing: Fraction of sampled worlds without a fall.
        """
        if self.plan is None or self.implausible:
            return False
        return (
            self.margin_fraction >= min_margin_fraction
            if self.sample is None
            else self.standing >= min_standing
        )

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
        if self.margin_fraction > NEGLIGIBLE_MARGIN:
            return f"{self.what}: verified"
        worst = "; ".join(self.plan.forces.notes)
        margin_text = f"{self.margin_fraction:.0%} of its margins"
        return f"{self.what}: verified, but may fall: {margin_text} ({worst})"
