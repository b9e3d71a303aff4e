"""Forces of the simulated legs: as planned, or by admittance control of compliant ones."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.kernels.body import moved
from climbplan.walking.online.admittance import AdmittanceGains, AdmittanceLegs, limited
from climbplan.walking.online.legs import Stance
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, WalkTask


class LegForces:
    """What legs give within a phase."""

    def __init__(self, task: WalkTask, gains: AdmittanceGains | None, dt: float) -> None:
        self._task, self._dt = task, dt
        self._legs: AdmittanceLegs | None = None
        if gains is not None:
            self._legs = AdmittanceLegs(gains, task.body.leg_count)
        self._first: Array | None = None  # (L, 3) toes in the body when the phase began
        self._plan: Array | None = None  # the state that was planned for the last sample
        self._planned: Array | None = None  # (L, 3) toes in the body, by plan, when it began

    def begin(self, state: Array, stance: Stance) -> None:
        """A phase begins in a state (12,)."""
        plan = stance.phase.plan
        self._plan = None
        if self._legs is not None and plan is not None:
            self._legs.begin()
            self._first = toes_in_body(state, stance.toes)
            self._plan = plan.state[0].copy()
            self._planned = toes_in_body(self._plan, plan.toes[0])

    def force(self, state: Array, stance: Stance, contact: BoolArray) -> Array:
        """Contact forces (L, 3) from this sample of the phase to the next; contact (L,) as made."""
        task, phase = self._task, stance.phase
        wanted, friction, most = phase.force, task.ground.friction, task.body.force_limit
        if self._legs is None or self._plan is None or phase.plan is None:
            return limited(wanted, contact, friction, most)
        assert self._first is not None
        assert self._planned is not None
        body, plan = task.body, phase.plan
        then = moved(
            body.mass,
            body.gravity,
            body.inertia,
            task.body.inverse,
            self._dt,
            1,
            self._plan,
            plan.toes[0],
            plan.force[0],
        )
        here, later = (toes_in_body(at, plan.toes[0]) for at in (self._plan, then))
        # Where legs would have their toes if they moved as planned since the phase began
        R = rotation_world_body(state[ANGLES])
        arm = (self._first + here - self._planned) @ R.T
        wanted_rate = state[VELOCITY] + np.cross(state[SPIN], arm)
        wanted_rate = wanted_rate + (later - here) / self._dt @ R.T
        ahead = stance.toes - state[POSITION] - arm
        force = limited(self._legs.force(wanted, ahead, -wanted_rate), contact, friction, most)
        self._legs.step(wanted, np.where(contact[:, None], force, wanted), self._dt)
        self._plan = then
        return force
