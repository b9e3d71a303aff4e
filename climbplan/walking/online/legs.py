"""Where the simulated robot's toes are, phase by phase of a command."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.kernels.ways import highest_beneath
from climbplan.walking.online.footholds import grounded
from climbplan.walking.online.safe_stance import braced_forces
from climbplan.walking.task.task import ANGLES, POSITION, VELOCITY, WalkTask, WalkTrajectory

_LANDING_MARGIN = 0.01  # [m]
_RISING = 0.2  # share of a swing in which a toe goes up, and again down
EDGE = 0.019  # [m] out of its box that a standing toe comes to before its leg lets go


@dataclass(frozen=True)
class Phase:
    """What legs do for one knot."""

    contact: BoolArray  # (L,) legs that are to stand
    force: Array  # (L, 3) planned [N]
    landing: Array  # (L, 3) where swinging toes are to come down
    plan: WalkTrajectory | None = None  # None before the first command

    def seen_from(self, task: WalkTask, state: Array) -> Phase:
        """The same to the body that is in a state (12,) where the plan took it to be in its first.

        Legs act in the body's frame: what is planned turns and shifts with the error of that.
        """
        if self.plan is None:
            return self
        thought = self.plan.state[0]
        turn = rotation_world_body(state[ANGLES]) @ rotation_world_body(thought[ANGLES]).T
        landing = state[POSITION] + (self.landing - thought[POSITION]) @ turn.T
        return replace(self, force=self.force @ turn.T, landing=grounded(task.ground, landing))


@dataclass(frozen=True)
class Stance:
    """Toes between two commands."""

    toes: Array  # (L, 3) where legs stand, or where the way of those in the air began
    before: Array  # (L, 3) one phase earlier
    stood: BoolArray  # (L,) in the phase before
    phase: Phase
    # (L,) shares of the phase, and of the way up and down, at which ways in the air began
    since: Array
    risen: Array

    def followed(self, task: WalkTask, state: Array, phase: Phase) -> Stance:
        """The next phase begins: legs in the air come down."""
        down = landed(task, state, self.phase.landing)
        toes = np.where(self.phase.contact[:, None], self.toes, down)
        start = np.zeros(len(toes))
        return Stance(toes, self.toes, self.phase.contact, phase, start, start)

    def redirected(self, task: WalkTask, phase: Phase, share: float, again: float) -> Stance:
        """Another plan for the rest of a phase: who stands may lift, who swings goes on from there.

        share: of the phase that is over; again: the same of the phase as long as it is now.
        """
        contact = self.phase.contact & phase.contact
        here, flying = self.over(task, share), ~self.phase.contact
        risen = np.where(flying, self._risen(share), 0.0)
        since = np.full(len(here), again)
        return replace(
            self, toes=here, phase=replace(phase, contact=contact), since=since, risen=risen
        )

    def over(self, task: WalkTask, share: float) -> Array:
        """(L, 3) where legs stand, or above which ground those in the air are."""
        here, flying = self.toes.copy(), ~self.phase.contact
        here[flying, :2] = self.shown(task, share)[flying, :2]
        return here

    def let_go(self, task: WalkTask, state: Array, share: float) -> Stance:
        """Legs at the edge of what they reach in a state (12,) leave the ground; others brace.

        Forces that are planned for all of them would turn the body over without these. share: of
        the phase that is over; they come down when it ends, no farther than they reach by then.
        """
        legs = self.beyond(task, state)
        if not legs.any():
            return self
        force = braced_forces(task, state, self.toes, self.phase.contact & ~legs)
        later = state.copy()
        later[POSITION] += (1.0 - share) * task.step * state[VELOCITY]
        return self.lifted(legs, force, landed(task, later, self.toes), share)

    def lifted(self, legs: BoolArray, force: Array, landing: Array, share: float) -> Stance:
        """Some standing legs (L,) leave the ground for where they are to come down (L, 3).

        force (L, 3): of the others from now on.
        """
        phase, chosen = self.phase, legs[:, None]
        return replace(
            self,
            phase=replace(
                phase,
                contact=phase.contact & ~legs,
                force=np.where(chosen, 0.0, force),
                landing=np.where(chosen, landing, phase.landing),
            ),
            since=np.where(legs, share, self.since),
            risen=np.where(legs, 0.0, self.risen),
        )

    def beyond(self, task: WalkTask, state: Array) -> BoolArray:
        """(L,) standing legs that are at the edge of what they reach in a state (12,)."""
        body = task.body
        off = np.abs(toes_in_body(state, self.toes) - body.toe_center) - body.toe_half
        found: BoolArray = self.phase.contact & (off.max(axis=1) > EDGE)
        return found

    def _risen(self, share: float) -> Array:
        """(L,) shares of the way up and down."""
        done = (share - self.since) / np.maximum(1.0 - self.since, 1e-9)
        risen: Array = self.risen + (1.0 - self.risen) * np.clip(done, 0.0, 1.0)
        return risen

    def shown(self, task: WalkTask, share: float) -> Array:
        """Toes (L, 3) on the way: swinging ones straight on, lifted as half a sine.

        Where the ground is not flat: up, across above all that lies beneath, and down. Ways that
        began within the phase go on from where they began.
        """
        toes, ground = self.toes.copy(), task.ground
        moving, landing = ~self.phase.contact, self.phase.landing
        risen = self._risen(share)
        if ground.endless:
            done = ((risen - self.risen) / np.maximum(1.0 - self.risen, 1e-9))[moving, None]
            toes[moving, :2] += done * (landing[moving, :2] - toes[moving, :2])
            toes[moving, 2] = task.lift * np.sin(np.pi * risen[moving])
            return toes
        gone = np.clip((np.stack([self.risen, risen]) - _RISING) / (1.0 - 2.0 * _RISING), 0.0, 1.0)
        ahead = (gone[1] - gone[0]) / np.maximum(1.0 - gone[0], 1e-9)
        for leg in np.flatnonzero(moving):
            across = float(ahead[leg])
            up = min(risen[leg], 1.0 - risen[leg], _RISING) / _RISING
            here, there = self.toes[leg], landing[leg]
            beneath = highest_beneath(
                here[:2], there[:2],
                ground.lower, ground.upper, ground.sides, ground.height, ground.slope, ground.inner,
            )  # fmt: skip
            top = max(here[2], there[2], beneath) + task.lift
            end = here[2] if risen[leg] < 0.5 else there[2]
            toes[leg, :2] += across * (there[:2] - here[:2])
            toes[leg, 2] = end + up * (top - end)
        return toes

    def thought(self, toes: Array) -> Stance:
        """The same as the controller knows it: toes as measured, the phase as it was planned.

        Its world may have drifted away from the true one. Which legs stand is felt.
        """
        if self.phase.plan is None:
            return replace(self, toes=toes)
        phase, now = phase_of(self.phase.plan), self.phase
        gone = phase.contact & ~now.contact
        if gone.any():
            landing = np.where(gone[:, None], now.landing, phase.landing)
            phase = replace(phase, contact=now.contact, force=now.force, landing=landing)
        return replace(self, toes=toes, phase=phase)


def phase_of(plan: WalkTrajectory) -> Phase:
    """The first knot of a plan."""
    return Phase(plan.gait.contact[0], plan.force[0], plan.toes[1], plan)


def standing(task: WalkTask, toes: Array) -> Stance:
    """All legs down with equal shares of the weight."""
    force = np.zeros_like(toes)
    force[:, 2] = task.weight / len(toes)
    every = np.ones(len(toes), bool)
    start = np.zeros(len(toes))
    return Stance(toes, toes, every, Phase(every, force, toes), start, start)


def landed(task: WalkTask, state: Array, landing: Array) -> Array:
    """Where swinging toes (L, 3) come down: where planned, or as near as legs reach by then.

    Reach them they have to until the interval ends, as fast as the body moves over them.
    """
    body, R = task.body, rotation_world_body(state[ANGLES])
    spots = (landing - state[POSITION]) @ R
    half = body.toe_half[:2] - _LANDING_MARGIN
    passed = (task.step * state[VELOCITY] @ R)[:2]
    room = np.minimum(np.abs(passed), body.toe_half[:2] + half)
    center = body.toe_center[:, :2]
    low = center - np.where(passed > 0, body.toe_half[:2] - room, half)
    high = center + np.where(passed < 0, body.toe_half[:2] - room, half)
    spots[:, :2] = np.clip(spots[:, :2], low, high)
    return grounded(task.ground, state[POSITION] + spots @ R.T)
