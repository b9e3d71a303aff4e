"""Random starts of a walk: the published ranges, and disturbances beyond them.

Published (8.2.4.5) are a forward velocity within 1.5 m/s and a forward acceleration within 15 m/s^2
either way. An acceleration is no part of a rigid body's state: it is taken for a push through the
knot before the plan, which begins at v_x + a_x dt with the toes under the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.walking.task import ANGLES, SPIN, VELOCITY, Start, WalkTask


@dataclass(frozen=True)
class StartRanges:
    """How far starts are drawn either way; the published ranges alone if left out."""

    forward: float = 1.5  # [m/s] v_x
    acceleration: float = 15.0  # [m/s^2] a_x, through one knot
    sideways: float = 0.0  # [m/s]
    tilt: float = 0.0  # [rad] roll and pitch
    yaw: float = 0.0  # [rad]
    spin: float = 0.0  # [rad/s] of each component
    toes: float = 0.0  # [m] of each toe along x and y


@dataclass(frozen=True)
class DrawnStart:
    """A task from a random start, and what was drawn."""

    task: WalkTask
    forward: float  # [m/s]
    acceleration: float  # [m/s^2]


def drawn_start(task: WalkTask, ranges: StartRanges, rng: np.random.Generator) -> DrawnStart:
    """The task from another start: what is drawn takes the place of its velocity and spin."""

    def either_way(size: float, count: int) -> np.ndarray:
        return size * rng.uniform(-1.0, 1.0, count)

    forward = float(either_way(ranges.forward, 1)[0])
    acceleration = float(either_way(ranges.acceleration, 1)[0])
    state = task.start.state.copy()
    sideways = float(either_way(ranges.sideways, 1)[0])
    state[VELOCITY] = [forward + task.step * acceleration, sideways, 0.0]
    state[ANGLES] += np.concatenate([either_way(ranges.tilt, 2), either_way(ranges.yaw, 1)])
    state[SPIN] = either_way(ranges.spin, 3)
    toes = task.start.toes.copy()
    toes[:, :2] += either_way(ranges.toes, toes[:, :2].size).reshape(-1, 2)
    return DrawnStart(replace(task, start=Start(state, toes)), forward, acceleration)
