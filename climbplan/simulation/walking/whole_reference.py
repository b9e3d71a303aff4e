"""What a plan asks of the whole robot at any time: body, toes on their ways, forces, normals.

Where the body is off its path, or faster or slower than planned, toes in the air land so much
farther as it will be off when it has slowed down (the capture point): on flat ground alone, as
elsewhere there may be nothing to stand on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.walking.reference import walk_reference
from climbplan.walking.plan import WalkPlan
from climbplan.walking.swing_way import along, arch
from climbplan.walking.task import ANGLES, POSITION, SPIN, VELOCITY, Array

_STEP_ASIDE = 2.0  # of a box's half extents, that a toe lands off its plan at most
_BEYOND = 1.1  # times as far as the capture point, so that the body comes back
_SETTLED = 0.9  # share of a swing after which its landing stays
_TOUCHDOWN = 0.01  # [m] below the ground that swings aim for, so that toes do land


@dataclass(frozen=True)
class Moving:
    """The body at a time, as planned; world frame."""

    position: Array  # (3,) of the centre of mass as it stands
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    rotation: Array  # (3, 3)
    spin: Array  # (3,)
    turning: Array  # (3,) angular acceleration


@dataclass(frozen=True)
class OnItsWay:
    """A swinging toe at a time."""

    place: Array  # (3,)
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    share: float  # of its way


class WholeReference:
    """A plan as functions of time. `contact`: (T, L) legs that stand until the next sample."""

    def __init__(self, plan: WalkPlan) -> None:
        self.plan, self.task = plan, plan.task
        self.base = walk_reference(plan)
        self.time, self.contact = self.base.time, self.base.contact
        ground, region = self.task.ground, plan.trajectory.gait.region
        self.normal: Array = ground.frame[region][..., 2, :]  # (T, L, 3)
        self.adapts = ground.count == 1
        self.pendulum = float(np.sqrt(self.task.reference.height[0] / self.task.body.gravity))
        self.left: list[Array | None] = [
            None
        ] * self.task.body.leg_count  # where swinging toes came from
        self.aside = np.zeros_like(self.task.body.toe_center)

    def sample(self, time: float) -> int:
        """The last sample before a time."""
        last = len(self.time) - 2
        return int(np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, last))

    def body(self, time: float) -> Moving:
        """Between samples velocities go straight, and positions so that they meet both."""
        n = self.sample(time)
        span = self.time[n + 1] - self.time[n]
        s = float(np.clip(time - self.time[n], 0.0, span))
        one, other = self.base.state[n], self.base.state[n + 1]
        push = self.plan.loop.push[n + 1] if self.plan.loop is not None else np.zeros(3)
        # What a push adds comes at once, not by planned forces
        acceleration = (other[VELOCITY] - push - one[VELOCITY]) / span
        curve = one[POSITION] + s * one[VELOCITY] + 0.5 * s**2 * acceleration
        end = one[POSITION] + span * one[VELOCITY] + 0.5 * span**2 * acceleration
        share = s / span
        return Moving(
            position=curve + share * (other[POSITION] - end),
            velocity=one[VELOCITY] + s * acceleration,
            acceleration=acceleration,
            rotation=rotation_world_body(one[ANGLES] + share * (other[ANGLES] - one[ANGLES])),
            spin=one[SPIN] + share * (other[SPIN] - one[SPIN]),
            turning=(other[SPIN] - one[SPIN]) / span,
        )

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
        if self.adapts and share < _SETTLED:
            most = _STEP_ASIDE * self.task.body.toe_half
            later = _BEYOND * np.exp((1.0 - share) * span / self.pendulum)  # by when it lands
            self.aside[leg, :2] = np.clip(later * off, -most, most)[:2]
        lands = way.lands + self.aside[leg] - [0.0, 0.0, _TOUCHDOWN]
        part, speed, more = along(share)
        up, rising, bent = arch(share)
        lift = np.array([0.0, 0.0, way.lift + abs(float(lands[2] - left[2])) / 2 + _TOUCHDOWN])
        place = left + part * (lands - left) + up * lift
        velocity = (speed * (lands - left) + rising * lift) / span
        acceleration = (more * (lands - left) + bent * lift) / span**2
        return OnItsWay(place, velocity, acceleration, share)

    def stands(self, leg: int) -> None:
        """A leg is down: its next swing begins where its toe is then."""
        self.left[leg] = None

    def planned_force(self, sample: int) -> Array:
        """(L, 3) of standing legs until the next sample [N]."""
        force = self.plan.trajectory.force[sample]
        return np.where(self.contact[sample][:, None], force, 0.0)
