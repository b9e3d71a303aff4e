"""Courses made into motion, leg after leg from wherever everything is then."""

from __future__ import annotations

import numpy as np

from climbplan.limms.arms.carrying import carry
from climbplan.limms.arms.chain_carrying import carry_on_chains
from climbplan.limms.arms.relatching import relatch
from climbplan.limms.attempts.attempts import Attempts
from climbplan.limms.legs.walking import walk
from climbplan.limms.motion.between_legs import Settle, as_it_is, headed, put_down, turned_to
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import Action, Course, Leg


class Motions:
    """Courses from one world; legs that several of them begin with are planned once."""

    def __init__(
        self,
        start: PlanSoFar,
        attempts: Attempts,
        rng: np.random.Generator,
        most_steps: int,
        last: Settle = as_it_is,
    ) -> None:
        """start: where everything is, its scene with boxes in the order of the plan.

        most_steps: of legs that walk; last: what follows the last leg.
        """
        self.start, self.attempts, self.rng = start, attempts, rng
        self.most_steps, self.last = most_steps, last
        self.known: dict[tuple[Leg, ...], PlanSoFar | None] = {}

    def plan(self, course: Course) -> PlanSoFar | None:
        """Everything until all boxes are at their goals, or None."""
        world: PlanSoFar | None = self.start
        legs = course.legs
        for number in range(1, len(legs)):
            if legs[:number] not in self.known:
                assert world is not None
                self.known[legs[:number]] = self._leg(world, legs[number - 1], 0.0, put_down)
            world = self.known[legs[:number]]
            if world is None:
                return None
        assert world is not None
        return self._leg(world, legs[-1], self.start.scene.arrival_speed, self.last)

    def _leg(self, world: PlanSoFar, leg: Leg, speed: float, settle: Settle) -> PlanSoFar | None:
        turned = turned_to(world, leg.box, self.start.scene)
        begun = headed(turned, np.array(leg.end), speed)
        return self._done(begun, leg.action, settle)

    def _done(self, world: PlanSoFar, action: Action, settle: Settle) -> PlanSoFar | None:
        """An action done by the program that there is for it."""
        if action.kind == "quadruped":
            return walk(world, self.attempts, self.most_steps, self.rng, settle=settle)
        if action.kind == "relatch":
            return relatch(world, action, self.attempts, self.rng, settle)
        if action.is_chained:
            return carry_on_chains(world, action, self.attempts, self.rng, settle=settle)
        return carry(world, action, self.attempts, self.rng, settle=settle)
