"""How far and how fast a motion goes that costs less than a known one, and where legs may stand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.micp.tube import Tube
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, STATE, VELOCITY, WalkTask


@dataclass(frozen=True)
class Ranges:
    """Where a motion can be that costs less than a known one."""

    velocity: tuple[Array, Array]  # (N + 1, 3) least and largest
    position: tuple[Array, Array]


def ranges_below(task: WalkTask, cost: float) -> Ranges:
    """Velocity and height tracking alone cost no more than a cost; forces move no faster."""
    knots, dt, body = task.knots, task.step, task.body
    start = task.start.state
    most = body.leg_count * body.force_limit / body.mass
    fastest = np.array([most, most, most - body.gravity])
    slowest = np.array([-most, -most, -body.gravity])
    with np.errstate(divide="ignore"):
        room = np.sqrt(cost / task.weights.velocity)
        rise = np.sqrt(cost / task.weights.height) if task.weights.height else np.inf
    low, high = (np.tile(start[VELOCITY], (knots + 1, 1)) for _ in range(2))
    p_low, p_high = (np.tile(start[POSITION], (knots + 1, 1)) for _ in range(2))
    for n in range(1, knots + 1):
        wanted = task.reference.velocity[n - 1]
        low[n] = np.maximum(low[n - 1] + dt * slowest, wanted - room)
        high[n] = np.minimum(high[n - 1] + dt * fastest, wanted + room)
        p_low[n] = p_low[n - 1] + dt * low[n - 1]
        p_high[n] = p_high[n - 1] + dt * high[n - 1]
        if n > 1:  # the first step is the start's
            p_low[n, 2] = max(p_low[n, 2], task.reference.height[n - 1] - rise)
            p_high[n, 2] = min(p_high[n, 2], task.reference.height[n - 1] + rise)
    return Ranges((low, high), (p_low, p_high))


@dataclass(frozen=True)
class Box:
    """What is known of every motion that a program holds; forces in its units.

    Of legs it is what holds where they stand.
    """

    low: Array  # (N + 1, 12) states
    high: Array
    off: Array  # (2,) the most that velocities along x and y that are not the cheapest cost them
    push_low: Array  # (N, 3) sums of forces, about the axes of the heading
    push_high: Array
    stands_low: Array  # (N, L) 1: stands in any case
    stands_high: Array  # 0: never
    arm_low: Array  # (N, L, 2) toe from the body along the heading and across [m]
    arm_high: Array
    force_low: Array  # (N, L, 3) about those axes
    force_high: Array

    @classmethod
    def open(cls, task: WalkTask, cost: float, most: float) -> Box:
        """Nothing is known but the limit of each force, and a cost."""
        knots, count = task.knots, task.body.leg_count
        states, legs, sums = (knots + 1, STATE), (knots, count), np.array([-count, -count, 0.0])
        return cls(
            np.full(states, -np.inf),
            np.full(states, np.inf),
            np.full(2, cost),
            np.tile(sums * most, (knots, 1)),
            np.full((knots, 3), count * most),
            np.zeros(legs),
            np.ones(legs),
            np.full((*legs, 2), -np.inf),
            np.full((*legs, 2), np.inf),
            np.tile(sums / count * most, (*legs, 1)),
            np.full((*legs, 3), most),
        )

    def standing(self, contact: BoolArray) -> Box:
        """The same of motions with these contacts (N, 4) only."""
        stands = contact.astype(float)
        return replace(self, stands_low=stands, stands_high=stands.copy())

    def tube(self, tube: Tube) -> Tube:
        """What a tube and the box have in common."""
        a, a_half = _common(
            tube.angles, tube.angles_half, self.low[:, ANGLES], self.high[:, ANGLES]
        )
        s, s_half = _common(tube.spin, tube.spin_half, self.low[:, SPIN], self.high[:, SPIN])
        return replace(tube, angles=a, angles_half=a_half, spin=s, spin_half=s_half)


def _common(middle: Array, half: Array, low: Array, high: Array) -> tuple[Array, Array]:
    below, above = np.maximum(middle - half, low), np.minimum(middle + half, high)
    above = np.maximum(above, below)
    return 0.5 * (below + above), 0.5 * (above - below)
