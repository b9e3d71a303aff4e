"""Stance and swing of the simulated robot's legs, phase by phase of a command."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.reference_dynamics import transform_toes_to_body
from climbplan.walking.kernels.swept_terrain import find_highest_terrain
from climbplan.walking.online.footholds import project_to_footholds
from climbplan.walking.online.safe_stance import solve_balance_forces
from climbplan.walking.task.task import ANGLES, POSITION, VELOCITY, WalkTask, WalkTrajectory

_LANDING_MARGIN = 0.01  # [m]
_VERTICAL_FRACTION = 0.2  # fraction of a swing in which a toe rises, and again descends
LIFT_OFF_VIOLATION = 0.019  # [m] outside its box at which a standing toe lifts off


@dataclass(frozen=True)
class StancePhase:
    """The legs' task during one interval of a plan."""

    contact: BoolArray  # (L,) legs in stance
    force: Array  # (L, 3) planned, world frame [N]
    landing: Array  # (L, 3) planned landings of swinging toes [m]
    plan: WalkTrajectory | None = None  # None before the first command

    def transform_to_state(self, task: WalkTask, state: Array) -> StancePhase:
        """Return the phase rotated and shifted from the planned first state to a true state (12,).

        Legs act in the body frame: forces and landings follow the error of the estimated state.
        """
        if self.plan is None:
            return self
        planned_state = self.plan.state[0]
        rotation = rotation_world_body(state[ANGLES]) @ rotation_world_body(planned_state[ANGLES]).T
        landing = state[POSITION] + (self.landing - planned_state[POSITION]) @ rotation.T
        return replace(
            self, force=self.force @ rotation.T, landing=project_to_footholds(task.ground, landing)
        )


@dataclass(frozen=True)
class ToeStance:
    """Positions and swing progress of the toes between two commands."""

    toes: Array  # (L, 3) stance positions, lift-off positions of swinging toes [m]
    previous_toes: Array  # (L, 3) one phase earlier
    previous_contact: BoolArray  # (L,) contacts of the previous phase
    phase: StancePhase
    # (L,) fractions of the phase, and of the whole swing, at which the swing trajectories begin
    swing_start: Array
    swing_phase_start: Array

    def start_phase(self, task: WalkTask, state: Array, phase: StancePhase) -> ToeStance:
        """Return the stance at the start of the next phase: swinging legs touch down."""
        touchdown = limit_landing(task, state, self.phase.landing)
        toes = np.where(self.phase.contact[:, None], self.toes, touchdown)
        zeros = np.zeros(len(toes))
        return ToeStance(toes, self.toes, self.phase.contact, phase, zeros, zeros)

    def replace_plan(
        self, task: WalkTask, phase: StancePhase, elapsed: float, new_elapsed: float
    ) -> ToeStance:
        """Return the stance under another plan for the rest of the phase.

        Standing legs may lift off; swinging legs continue from their present positions.

        Args:
            task: the walking task.
            phase: the new plan's first phase.
            elapsed: fraction of the phase that is over.
            new_elapsed: the same with respect to the phase's new length.
        """
        contact = self.phase.contact & phase.contact
        toes, airborne = self.project_toes(task, elapsed), ~self.phase.contact
        swing_phase_start = np.where(airborne, self._compute_swing_phase(elapsed), 0.0)
        swing_start = np.full(len(toes), new_elapsed)
        return replace(
            self,
            toes=toes,
            phase=replace(phase, contact=contact),
            swing_start=swing_start,
            swing_phase_start=swing_phase_start,
        )

    def project_toes(self, task: WalkTask, fraction: float) -> Array:
        """Return stance positions (L, 3); swinging toes are projected to their lift-off height."""
        toes, airborne = self.toes.copy(), ~self.phase.contact
        toes[airborne, :2] = self.compute_toes(task, fraction)[airborne, :2]
        return toes

    def lift_unreachable_feet(self, task: WalkTask, state: Array, fraction: float) -> ToeStance:
        """Lift standing feet at the edge of their workspace in a state (12,); the others balance.

        The planned forces of all legs would turn the body over without these feet. Lifted feet
        land when the phase ends, within their reach by then.

        Args:
            task: the walking task.
            state: (12,) of the body.
            fraction: fraction of the phase that is over.
        """
        legs = self.find_unreachable_feet(task, state)
        if not legs.any():
            return self
        force = solve_balance_forces(task, state, self.toes, self.phase.contact & ~legs)
        end_state = state.copy()
        end_state[POSITION] += (1.0 - fraction) * task.dt * state[VELOCITY]
        return self.lift_legs(legs, force, limit_landing(task, end_state, self.toes), fraction)

    def lift_legs(
        self, legs: BoolArray, force: Array, landing: Array, fraction: float
    ) -> ToeStance:
        """Return the stance with some standing legs in swing.

        Args:
            legs: (L,) legs that lift off.
            force: (L, 3) forces of the others from now on [N].
            landing: (L, 3) landings of the lifted legs [m].
            fraction: fraction of the phase that is over.
        """
        phase, lifted = self.phase, legs[:, None]
        return replace(
            self,
            phase=replace(
                phase,
                contact=phase.contact & ~legs,
                force=np.where(lifted, 0.0, force),
                landing=np.where(lifted, landing, phase.landing),
            ),
            swing_start=np.where(legs, fraction, self.swing_start),
            swing_phase_start=np.where(legs, 0.0, self.swing_phase_start),
        )

    def find_unreachable_feet(self, task: WalkTask, state: Array) -> BoolArray:
        """Return standing legs (L,) at the edge of their workspace in a state (12,)."""
        body = task.body
        violation = (
            np.abs(transform_toes_to_body(state, self.toes) - body.toe_center) - body.toe_half
        )
        unreachable: BoolArray = self.phase.contact & (violation.max(axis=1) > LIFT_OFF_VIOLATION)
        return unreachable

    def _compute_swing_phase(self, fraction: float) -> Array:
        """Return the swing phase (L,) in [0, 1]: the fraction of the vertical profile."""
        progress = (fraction - self.swing_start) / np.maximum(1.0 - self.swing_start, 1e-9)
        swing_phase: Array = self.swing_phase_start + (1.0 - self.swing_phase_start) * np.clip(
            progress, 0.0, 1.0
        )
        return swing_phase

    def compute_toes(self, task: WalkTask, fraction: float) -> Array:
        """Return toes (L, 3) at a fraction of the phase.

        On flat ground swinging toes move straight, with half a sine as height. On terrain they go
        up, across above the terrain under their path, and down. A trajectory that began within the
        phase continues from its lift-off position.
        """
        toes, ground = self.toes.copy(), task.ground
        airborne, landing = ~self.phase.contact, self.phase.landing
        swing_phase = self._compute_swing_phase(fraction)
        if ground.is_flat_everywhere:
            progress = (
                (swing_phase - self.swing_phase_start)
                / np.maximum(1.0 - self.swing_phase_start, 1e-9)
            )[airborne, None]
            toes[airborne, :2] += progress * (landing[airborne, :2] - toes[airborne, :2])
            toes[airborne, 2] = task.swing_clearance * np.sin(np.pi * swing_phase[airborne])
            return toes
        horizontal_phase = np.clip(
            (np.stack([self.swing_phase_start, swing_phase]) - _VERTICAL_FRACTION)
            / (1.0 - 2.0 * _VERTICAL_FRACTION),
            0.0,
            1.0,
        )
        horizontal_progress = (horizontal_phase[1] - horizontal_phase[0]) / np.maximum(
            1.0 - horizontal_phase[0], 1e-9
        )
        for leg in np.flatnonzero(airborne):
            horizontal = float(horizontal_progress[leg])
            vertical = (
                min(swing_phase[leg], 1.0 - swing_phase[leg], _VERTICAL_FRACTION)
                / _VERTICAL_FRACTION
            )
            lift_off, touchdown = self.toes[leg], landing[leg]
            terrain_height = find_highest_terrain(lift_off[:2], touchdown[:2], ground.region_arrays)
            top = max(lift_off[2], touchdown[2], terrain_height) + task.swing_clearance
            nearer_height = lift_off[2] if swing_phase[leg] < 0.5 else touchdown[2]
            toes[leg, :2] += horizontal * (touchdown[:2] - lift_off[:2])
            toes[leg, 2] = nearer_height + vertical * (top - nearer_height)
        return toes

    def replace_toes(self, toes: Array) -> ToeStance:
        """Return the stance as the controller knows it: measured toes, and the planned phase.

        Its world frame may have drifted from the true one. Contacts are measured.
        """
        if self.phase.plan is None:
            return replace(self, toes=toes)
        phase, executed = extract_first_phase(self.phase.plan), self.phase
        lifted_early = phase.contact & ~executed.contact
        if lifted_early.any():
            landing = np.where(lifted_early[:, None], executed.landing, phase.landing)
            phase = replace(phase, contact=executed.contact, force=executed.force, landing=landing)
        return replace(self, toes=toes, phase=phase)


def extract_first_phase(plan: WalkTrajectory) -> StancePhase:
    """Return the first interval of a plan."""
    return StancePhase(plan.gait.contact[0], plan.force[0], plan.toes[1], plan)


def build_stance(task: WalkTask, toes: Array) -> ToeStance:
    """Return the stance of all legs with equal fractions of the weight."""
    force = np.zeros_like(toes)
    force[:, 2] = task.weight / len(toes)
    all_legs = np.ones(len(toes), bool)
    zeros = np.zeros(len(toes))
    return ToeStance(toes, toes, all_legs, StancePhase(all_legs, force, toes), zeros, zeros)


def limit_landing(task: WalkTask, state: Array, landing: Array) -> Array:
    """Return landings (L, 3) of swinging toes, moved into reach at the end of the interval.

    Toes must stay in reach until the next interval ends while the body moves over them.
    """
    body, R = task.body, rotation_world_body(state[ANGLES])
    toes = (landing - state[POSITION]) @ R
    half = body.toe_half[:2] - _LANDING_MARGIN
    travel = (task.dt * state[VELOCITY] @ R)[:2]
    extension = np.minimum(np.abs(travel), body.toe_half[:2] + half)
    center = body.toe_center[:, :2]
    lower = center - np.where(travel > 0, body.toe_half[:2] - extension, half)
    upper = center + np.where(travel < 0, body.toe_half[:2] - extension, half)
    toes[:, :2] = np.clip(toes[:, :2], lower, upper)
    return project_to_footholds(task.ground, state[POSITION] + toes @ R.T)
