"""Contact forces of the simulated legs: as planned, or by admittance control of compliant legs."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.reference_dynamics import transform_toes_to_body
from climbplan.walking.kernels.body import integrate_rk4
from climbplan.walking.online.admittance import AdmittanceController, AdmittanceGains, limit_forces
from climbplan.walking.online.stance import ToeStance
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, WalkTask


class LegForces:
    """The contact forces of the simulated legs within a phase."""

    def __init__(self, task: WalkTask, gains: AdmittanceGains | None, dt: float) -> None:
        """Choose the leg model.

        Args:
            task: the walking task.
            gains: gains of the admittance controller; None if legs give the planned force exactly.
            dt: sample time [s].
        """
        self._task, self._dt = task, dt
        self._admittance: AdmittanceController | None = None
        if gains is not None:
            self._admittance = AdmittanceController(gains, task.body.leg_count)
        self._start_toes: Array | None = None  # (L, 3) body-frame toes at the start of the phase
        self._planned_state: Array | None = None  # (12,) planned for the last sample
        self._planned_toes: Array | None = None  # (L, 3) planned `_start_toes`

    def start_phase(self, state: Array, stance: ToeStance) -> None:
        """Start a phase in a state (12,)."""
        plan = stance.phase.plan
        self._planned_state = None
        if self._admittance is not None and plan is not None:
            self._admittance.reset()
            self._start_toes = transform_toes_to_body(state, stance.toes)
            self._planned_state = plan.state[0].copy()
            self._planned_toes = transform_toes_to_body(self._planned_state, plan.toes[0])

    def compute_forces(self, state: Array, stance: ToeStance, contact: BoolArray) -> Array:
        """Return the contact forces (L, 3) of one sample of the phase, world frame [N].

        Args:
            state: (12,) true state.
            stance: toes and phase of the legs.
            contact: (L,) legs in contact.
        """
        task, phase = self._task, stance.phase
        planned_force, friction, force_limit = (
            phase.force,
            task.ground.friction,
            task.body.force_limit,
        )
        if self._admittance is None or self._planned_state is None or phase.plan is None:
            return limit_forces(planned_force, contact, friction, force_limit)
        assert self._start_toes is not None
        assert self._planned_toes is not None
        body, plan = task.body, phase.plan
        next_planned = integrate_rk4(
            body.parameters,
            self._dt,
            1,
            self._planned_state,
            plan.toes[0],
            plan.force[0],
        )
        planned_toes, next_planned_toes = (
            transform_toes_to_body(planned_state, plan.toes[0])
            for planned_state in (self._planned_state, next_planned)
        )
        # Toe positions relative to the body if legs had followed the plan since the phase began
        R = rotation_world_body(state[ANGLES])
        desired_arm = (self._start_toes + planned_toes - self._planned_toes) @ R.T
        desired_velocity = state[VELOCITY] + np.cross(state[SPIN], desired_arm)
        desired_velocity = desired_velocity + (next_planned_toes - planned_toes) / self._dt @ R.T
        toe_offset = stance.toes - state[POSITION] - desired_arm
        force = limit_forces(
            self._admittance.compute_forces(planned_force, toe_offset, -desired_velocity),
            contact,
            friction,
            force_limit,
        )
        self._admittance.integrate(
            planned_force, np.where(contact[:, None], force, planned_force), self._dt
        )
        self._planned_state = next_planned
        return force
