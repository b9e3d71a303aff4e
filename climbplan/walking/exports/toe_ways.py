"""Where the toes of a walk are at any time: on their stance points, or swinging between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.plan.swing_way import SwingWay, held_back
from climbplan.walking.plan.walk_plan import WalkPlan


@dataclass(frozen=True)
class ToePhase:
    """A stance or a swing of one leg, from a sample of the plan to a later one."""

    first: int
    last: int
    place: Array  # (3,) where the toe stands, of a swing where it lands [m]
    way: SwingWay | None  # None: it stands

    def at(self, time: float, step: float) -> Array:
        """Place (3,) of the toe at a time of the plan [s], of samples every `step` [s]."""
        if self.way is None:
            return self.place
        begin, end = self.first * step, self.last * step
        return self.way.at(min(max((time - begin) / (end - begin), 0.0), 1.0))[0]


def toe_phases(plan: WalkPlan, foot: float = 0.0) -> list[list[ToePhase]]:
    """Return the phases of every leg by interval: [leg][n] is that from sample n to the next.

    Args:
        plan: A walk; its toes stand still where they stand.
        foot: Radius of feet [m], which keep clear of risers on their way.
    """
    found, task = plan.trajectory, plan.task
    intervals = len(found.state) - 1
    phases: list[list[ToePhase]] = []
    for leg in range(task.body.leg_count):
        own: list[ToePhase] = []
        contact = found.gait.contact[:intervals, leg]
        edges = np.flatnonzero(np.diff(contact.astype(np.int8))) + 1
        for first, last in zip([0, *edges], [*edges, intervals], strict=True):
            if contact[first]:
                phase = ToePhase(first, last, found.toes[first, leg], None)
            else:
                phase = _swing(plan, leg, int(first), int(last), foot)
            own += [phase] * int(last - first)
        phases.append(own)
    return phases


def _swing(plan: WalkPlan, leg: int, first: int, last: int, foot: float) -> ToePhase:
    task, toes = plan.task, plan.trajectory.toes[:, leg]
    left, lands = toes[max(first - 1, 0)], toes[last]
    top = max(float(toes[first:last, 2].max()), max(left[2], lands[2]) + task.lift)
    above = top - 0.5 * float(left[2] + lands[2])
    alone = held_back(task.ground, left, lands, above, foot)
    return ToePhase(first, last, lands, SwingWay(left, lands, above, *alone))
