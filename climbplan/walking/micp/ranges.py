"""How far and how fast a motion goes that costs less than a known one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.walking.task import LEGS, POSITION, VELOCITY, Array, WalkTask


@dataclass(frozen=True)
class Ranges:
    """Where a motion can be that costs less than a known one."""

    velocity: tuple[Array, Array]  # (N + 1, 3) least and largest
    position: tuple[Array, Array]


def ranges_below(task: WalkTask, cost: float) -> Ranges:
    """Velocity and height tracking alone cost no more than a cost; forces move no faster."""
    knots, dt, body = task.knots, task.step, task.body
    start = task.start.state
    most = LEGS * body.force_limit / body.mass
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
