"""What a plan asks of the whole robot at any time: body, toes on their ways, forces, normals.

Where the body is off its path, or faster or slower than planned, toes in the air land so much
farther as it will be off when it has slowed down (the capture point), as far as the region goes
that they are to stand on. Where a toe would run into a riser on its way it goes up alone at first,
or down alone at last, for as long as it takes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.walking.reference import walk_reference
from climbplan.walking.plan import WalkPlan
from climbplan.walking.swing_way import along, arch
from climbplan.walking.task import ANGLES, POSITION, SPIN, VELOCITY, Array, Whole

_STEP_ASIDE = 2.0  # of a box's half extents, that a toe lands off its plan at most
_BEYOND = 1.1  # times as far as the capture point, so that the body comes back
_SETTLED = 0.9  # share of a swing after which its landing stays
_HELD_BACK = (0.0, 0.1, 0.2, 0.3)  # shares of a swing in which a toe goes up or down alone
_GLANCES = 33  # at a way, for what it has to clear
_BESIDE = 0.003  # [m] that feet may be nearer to what is higher than they are thick
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
    """A plan as functions of time. `contact`: (T, L) legs that stand until the next sample.

    foot: radius of feet [m], by which their middles keep off what is higher.
    """

    def __init__(self, plan: WalkPlan, foot: float = 0.0) -> None:
        self.plan, self.task, self.foot = plan, plan.task, foot
        self.base = walk_reference(plan)
        self.time, self.contact = self.base.time, self.base.contact
        self.region: Whole = plan.trajectory.gait.region  # (T, L) in the air: where toes will land
        self.normal: Array = self.task.ground.frame[self.region][..., 2, :]  # (T, L, 3)
        self.pendulum = float(np.sqrt(self.task.reference.height[0] / self.task.body.gravity))
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
            self.alone[leg] = self._alone(left, way.lands, way.lift)
        if share < _SETTLED:
            most = _STEP_ASIDE * self.task.body.toe_half
            later = _BEYOND * np.exp((1.0 - share) * span / self.pendulum)  # by when it lands
            aside = np.append(np.clip(later * off, -most, most)[:2], 0.0)
            self.aside[leg] = self._on_region(self.sample(time), leg, way.lands, aside)
        lands = way.lands + self.aside[leg] - [0.0, 0.0, _TOUCHDOWN]
        first, last = self.alone[leg]
        rate = 1.0 / (1.0 - first - last)
        part, speed, more = along(float(np.clip(rate * (share - first), 0.0, 1.0)))
        upward, climbing, faster = along(share)
        up, rising, bent = arch(share)
        lift = _top(way.lift, left, lands)
        level, rise = np.array([1.0, 1.0, 0.0]) * (lands - left), lands[2] - left[2]
        high = np.array([0.0, 0.0, 1.0])
        place = left + (part * level + upward * rise * high) + up * lift * high
        velocity = (rate * speed * level + (climbing * rise + rising * lift) * high) / span
        acceleration = rate**2 * more * level + (faster * rise + bent * lift) * high
        return OnItsWay(place, velocity, acceleration / span**2, share)

    def _alone(self, left: Array, lands: Array, lift: float) -> tuple[float, float]:
        """Shares of a swing, at its begin and its end, in which its toe goes up or down alone.

        The least with which it is above all ground that its foot passes; the largest if none is.
        """
        ground = self.task.ground
        if ground.count == 1:
            return 0.0, 0.0
        share = np.linspace(0.0, 1.0, _GLANCES)
        height = left[2] + along(share)[0] * (lands[2] - left[2])
        height = height + arch(share)[0] * _top(lift, left, lands)
        every = np.arange(ground.count)
        found = [_HELD_BACK[-1], _HELD_BACK[-1]]
        for end, half in enumerate((share <= 0.5, share >= 0.5)):
            for alone in _HELD_BACK:
                first, last = (alone, 0.0) if end == 0 else (0.0, alone)
                part = along(np.clip((share[half] - first) / (1.0 - first - last), 0.0, 1.0))[0]
                spots = left[:2] + part[:, None] * (lands - left)[:2]
                off = ground.outside(every, spots[:, None])  # (K, S)
                level = ground.level_at(every, spots[:, None])
                beneath = np.where(off < self.foot - _BESIDE, level, -np.inf).max(axis=1)
                if (height[half] >= beneath - _BESIDE).all():
                    found[end] = alone
                    break
        return found[0], found[1]

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
