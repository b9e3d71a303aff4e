"""A cart-pole between soft walls that move, controlled at 50 Hz: arXiv 2406.00780.

The walls are springs, which take one binary a wall and step; the plan holds them where they are
now. They swing and drift, and the pole is shoved every now and then so that it needs them. The
plant is the cart-pole itself, not its linear model.

State (x, theta, v, omega): cart to the right [m], pole to the left [rad], and their rates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from climbplan.program.problem import Problem
from climbplan.program.statement import Program

Array = NDArray[np.float64]

TICK = 0.02  # [s] of the controller and of the plan's steps
CART, TIP, LENGTH = 1.0, 0.4, 0.6  # [kg], [kg], [m]
GRAVITY = 9.81  # [m/s^2]
STIFFNESS = 50.0  # [N/m]
WALLS = np.array([0.35, 0.40])  # [m] right and left wall from the middle
REACH, MOST_FORCE, MOST_INPUT = 0.6, 30.0, 20.0  # [m] of the tip, [N], [N]
SIDE = np.array([1.0, -1.0])  # right wall, left wall

SWING, SWINGS = 0.03, 1.0  # [m], [1/s] of both walls, as published
DRIFT, MOST_DRIFT = 0.2, 0.1  # [m/s] standard deviation over 5 ms, as published; [m] kept within
SHOVE, SHOVES = 1.5, 0.5  # [rad/s] standard deviation of the pole's rate; [1/s] how often
_PART = 0.005  # [s] of the plant

_FALL = np.array(
    [
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [0, GRAVITY * TIP / CART, 0, 0],
        [0, GRAVITY * (CART + TIP) / (CART * LENGTH), 0, 0],
    ]
)
A = np.eye(4) + TICK * _FALL
B = TICK * np.array([[0], [0], [1 / CART], [1 / (CART * LENGTH)]])
E = TICK * np.outer([0, 0, 0, 1 / (TIP * LENGTH)], SIDE)  # the right wall pushes left
Q, R = np.diag([1.0, 50.0, 1.0, 50.0]), np.array([[0.1]])


def moving_walls(horizon: int) -> Problem:
    """Bring the pole upright and the cart to the middle; parameters `start` (4,), `walls` (2,).

    horizon: steps, 10 as published; two binaries each.
    """
    p = Program("moving_walls")
    start, walls = p.parameter("start", (4,)), p.parameter("walls", (2,))
    most = np.array([REACH, np.pi / 2, 2 * REACH / TICK, np.pi / TICK])
    x = p.continuous("state", (horizon + 1, 4), -most, most)
    u = p.continuous("input", (horizon, 1), -MOST_INPUT, MOST_INPUT, unit="N")
    force = p.continuous("force", (horizon, 2), 0.0, MOST_FORCE, unit="N")
    touch = p.binary("touch", (horizon, 2))
    p.equal("dynamics.start", x[0] - start)
    p.equal("dynamics.step", x[1:] - x[:-1] @ A.T - u @ B.T - force @ E.T)
    tip = x[:-1, 0] - LENGTH * x[:-1, 1]
    depth = tip[:, None] * SIDE - walls
    p.between("tip.reach", tip, -REACH, REACH, unit="m")
    p.when("wall.law", touch, force - STIFFNESS * depth, 0.0, 0.0, unit="N")
    p.when("wall.inside", touch, depth, lower=0.0, unit="m")
    p.when("wall.free", touch, force, upper=0.0, unit="N", value=False)
    p.when("wall.outside", touch, depth, upper=0.0, unit="m", value=False)
    terminal = solve_discrete_are(A, B, Q, R)
    p.minimise("state", sum(row @ Q @ row for row in x[:-1]))
    p.minimise("input", R[0, 0] * np.sum(u**2))
    p.minimise("terminal", x[-1] @ terminal @ x[-1])
    return Problem("moving_walls", p)


class Plant:
    """The cart-pole and its walls; all chance comes from one seed, whatever is put in."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.state = np.zeros(4)
        self.walls = WALLS.copy()
        self._drift = np.zeros(2)
        self._time = 0.0

    def tick(self, force: float) -> None:
        """One tick with a force on the cart [N]."""
        draws = self._rng.normal(0.0, 1.0, (round(TICK / _PART), 2))
        shoved, strength = self._rng.uniform(), self._rng.normal()
        for draw in draws:
            self._drift = np.clip(self._drift + DRIFT * _PART * draw, -MOST_DRIFT, MOST_DRIFT)
            self.walls = WALLS + SWING * np.sin(2 * np.pi * SWINGS * self._time) + self._drift
            self.state = self._stepped(force)
            self._time += _PART
        if shoved < SHOVES * TICK:
            self.state[3] += SHOVE * strength

    @property
    def fallen(self) -> bool:
        """Whether the pole lies."""
        return bool(abs(self.state[1]) > np.pi / 2)

    def stand_up(self) -> None:
        """Upright in the middle, at rest."""
        self.state = np.zeros(4)

    def _stepped(self, force: float) -> Array:
        """The state after a part of a tick, by Runge-Kutta of fourth order."""
        x, h = self.state, _PART
        a = self._rates(x, force)
        b = self._rates(x + 0.5 * h * a, force)
        c = self._rates(x + 0.5 * h * b, force)
        d = self._rates(x + h * c, force)
        return np.asarray(x + h / 6 * (a + 2 * b + 2 * c + d))

    def _rates(self, state: Array, force: float) -> Array:
        x, theta, v, omega = state
        s, c = np.sin(theta), np.cos(theta)
        depth = np.maximum((x - LENGTH * s) * SIDE - self.walls, 0.0)
        push = -float(SIDE @ (STIFFNESS * depth))  # on the tip, to the right
        # (CART + TIP) dv - TIP LENGTH c domega = force + push - TIP LENGTH s omega^2
        # LENGTH domega - c dv = GRAVITY s - push c / TIP
        left = np.array([[CART + TIP, -TIP * LENGTH * c], [-c, LENGTH]])
        right = [force + push - TIP * LENGTH * s * omega**2, GRAVITY * s - push * c / TIP]
        dv, domega = np.linalg.solve(left, right)
        return np.array([v, omega, dv, domega])
