"""Positions of a walk's toes at any time: stance points and swing trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.plan.swing_trajectory import SwingTrajectory, choose_vertical_fractions
from climbplan.walking.plan.walk_plan import WalkPlan


@dataclass(frozen=True)
class ToePhase:
    """A stance or a swing of one leg, from a sample of the plan to a later one."""

    first: int
    last: int
    position: Array  # (3,) stance position; of a swing its landing [m]
    swing: SwingTrajectory | None  # None: stance

    def compute_position(self, time: float, step: float) -> Array:
        """Return the toe (3,) at a time of the plan [s], with samples every `step` [s]."""
        if self.swing is None:
            return self.position
        begin, end = self.first * step, self.last * step
        return self.swing.evaluate(min(max((time - begin) / (end - begin), 0.0), 1.0))[0]


def build_toe_phases(plan: WalkPlan, foot: float = 0.0) -> list[list[ToePhase]]:
    """Build the phases of every leg by interval: [leg][n] is that from sample n to the next.

    Args:
        plan: a walk; standing toes do not move.
        foot: radius of feet, which keep clear of risers [m].
    """
    trajectory, task = plan.trajectory, plan.task
    intervals = len(trajectory.state) - 1
    phases: list[list[ToePhase]] = []
    for leg in range(task.body.leg_count):
        leg_phases: list[ToePhase] = []
        contact = trajectory.gait.contact[:intervals, leg]
        edges = np.flatnonzero(np.diff(contact.astype(np.int8))) + 1
        for first, last in zip([0, *edges], [*edges, intervals], strict=True):
            if contact[first]:
                phase = ToePhase(first, last, trajectory.toes[first, leg], None)
            else:
                phase = _build_swing(plan, leg, int(first), int(last), foot)
            leg_phases += [phase] * int(last - first)
        phases.append(leg_phases)
    return phases


def _build_swing(plan: WalkPlan, leg: int, first: int, last: int, foot: float) -> ToePhase:
    """Build the swing of a leg between two samples."""
    task, toes = plan.task, plan.trajectory.toes[:, leg]
    lift_off, touchdown = toes[max(first - 1, 0)], toes[last]
    top = max(
        float(toes[first:last, 2].max()), max(lift_off[2], touchdown[2]) + task.swing_clearance
    )
    above = top - 0.5 * float(lift_off[2] + touchdown[2])
    fractions = choose_vertical_fractions(task.ground, lift_off, touchdown, above, foot)
    return ToePhase(first, last, touchdown, SwingTrajectory(lift_off, touchdown, above, *fractions))
