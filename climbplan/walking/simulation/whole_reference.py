"""What a plan asks of the whole robot at any time: body, toes on their ways, forces, normals.

Where the body is off its path, or faster or slower than planned, toes in the air land so much
farther as it will be off when it has slowed down (the capture point), as far as the region goes
that they are to stand on. Where a toe would run into a riser on its way it goes up alone at first,
or down alone at last, for as long as it takes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.walking.plan.body_way import Moving, body_within
from climbplan.walking.plan.swing_way import SwingWay, held_back
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.reference import walk_reference

_STEP_ASIDE = 2.0  # of a box's half extents, that a toe lands off its plan at most
_BEYOND = 1.1  # times as far as the capture point, so that the body comes back
_SETTLED = 0.9  # share of a swing after which its landing stays
_TOUCHDOWN = 0.01  # [m] below the ground that swings aim for, so that toes do land


@dataclass(frozen=True)
class OnItsWay:
    """A swinging toe at a time."""

    place: Array  # (3,)
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    share: float  # of its way


class WholeReference:
    """A plan as functions of time. `contact`: (T, L) legs that stand until the next sample.

    foot: radius of feet [m], by which their middles keep off what is higher.
    """

    def __init__(self, plan: WalkPlan, foot: float = 0.0) -> None:
        self.plan, self.task, self.foot = plan, plan.task, foot
        self.base = walk_reference(plan)
        self.time, self.contact = self.base.time, self.base.contact
        self.region: IntArray = (
            plan.trajectory.gait.region
        )  # (T, L) in the air: where toes will land
        self.normal: Array = self.task.ground.frame[self.region][..., 2, :]  # (T, L, 3)
        height = self.task.reference.height[0] - self.task.ground.standoff
        self.pendulum = float(np.sqrt(height / self.task.body.gravity))
        self.left: list[Array | None] = [
            None
        ] * self.task.body.leg_count  # where swinging toes came from
        self.aside = np.zeros_like(self.task.body.toe_center)
        self.alone = [(0.0, 0.0)] * self.task.body.leg_count  # shares of swings, first and last

    def sample(self, time: float) -> int:
        """The last sample before a time."""
        last = len(self.time) - 2
        return int(np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, last))

    def body(self, time: float) -> Moving:
        """Between samples velocities go straight, and positions so that they meet both."""
        n = self.sample(time)
        return body_within(self.plan, n, float(np.clip(time, self.time[n], self.time[n + 1])))

    def swing(self, leg: int, time: float, toe: Array, off: Array) -> OnItsWay:
        """Where a swinging toe is to be.

        toe: (3,) where it is; off: (3,) where the body's capture point is off its plan.
        """
        ways = self.base.swings[leg]
        way = next((one for one in ways if time < one.end), ways[-1])
        span = max(way.end - way.start, 1e-6)
        share = float(np.clip((time - way.start) / span, 0.0, 1.0))
        left = self.left[leg]
        if left is None:
            left = self.left[leg] = toe.copy()
            self.aside[leg] = 0.0
            self.alone[leg] = held_back(
                self.task.ground, left, way.lands, _top(way.lift, left, way.lands), self.foot
            )
        if share < _SETTLED:
            most = _STEP_ASIDE * self.task.body.toe_half
            later = _BEYOND * np.exp((1.0 - share) * span / self.pendulum)  # by when it lands
            aside = np.append(np.clip(later * off, -most, most)[:2], 0.0)
            self.aside[leg] = self._on_region(self.sample(time), leg, way.lands, aside)
        lands = way.lands + self.aside[leg] - [0.0, 0.0, _TOUCHDOWN]
        first, last = self.alone[leg]
        curve = SwingWay(left, lands, _top(way.lift, left, lands), first, last)
        place, velocity, acceleration = curve.at(share)
        return OnItsWay(place, velocity / span, acceleration / span**2, share)

    def _on_region(self, sample: int, leg: int, planned: Array, aside: Array) -> Array:
        """(3,) as far aside of where it was to land as the leg's region goes, and on its plane."""
        ground, region = self.task.ground, self.region[sample, leg]
        wanted = planned[:2] + aside[:2]
        spot = ground.into(region, wanted)
        rise = ground.level_at(region, spot) - ground.level_at(region, planned[:2])
        moved: Array = aside + np.append(spot - wanted, rise)
        return moved

    def stands(self, leg: int) -> None:
        """A leg is down: its next swing begins where its toe is then."""
        self.left[leg] = None

    def planned_force(self, sample: int) -> Array:
        """(L, 3) of standing legs until the next sample [N]."""
        force = self.plan.trajectory.force[sample]
        return np.where(self.contact[sample][:, None], force, 0.0)


def _top(lift: float, left: Array, lands: Array) -> float:
    """How far a way's middle is above that of the straight line [m]."""
    return lift + abs(float(lands[2] - left[2])) / 2 + _TOUCHDOWN
