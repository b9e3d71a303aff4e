"""A cart-pole between soft walls that move, controlled at 50 Hz: arXiv 2406.00780.

The walls are springs, which take one binary a wall and step; the plan holds them where they are
now. They swing and drift, and the pole is shoved every now and then so that it needs them. The
plant is the cart-pole itself, not the linear model of `specs/cart_pole.py`, which plans.

State (x, theta, v, omega): cart to the right [m], pole to the left [rad], and their rates.
"""

from __future__ import annotations

import numpy as np

from benchmarks.engine.shipped import shipped_cart_pole
from climbplan.arrays import Array
from climbplan.program.problem import Problem

_STATED = shipped_cart_pole()
TICK = _STATED.STEP  # [s] of the controller and of the plan's steps
CART, TIP, LENGTH = _STATED.CART, _STATED.TIP_MASS, _STATED.LENGTH  # [kg], [kg], [m]
GRAVITY, STIFFNESS = _STATED.GRAVITY, _STATED.STIFFNESS  # [m/s^2], [N/m]
WALLS: Array = _STATED.WALLS  # [m] right and left wall from the middle
SIDE: Array = _STATED.SIDE

SWING, SWINGS = 0.03, 1.0  # [m], [1/s] of both walls, as published
DRIFT, MOST_DRIFT = 0.2, 0.1  # [m/s] standard deviation over 5 ms, as published; [m] kept within
SHOVE, SHOVES = 1.5, 0.5  # [rad/s] standard deviation of the pole's rate; [1/s] how often
_PART = 0.005  # [s] of the plant


def moving_walls(horizon: int) -> Problem:
    """The statement of `specs/cart_pole.py` with springs; parameters `start` (4,), `walls` (2,).

    horizon: steps, 10 as published; two binaries each.
    """
    return Problem("moving_walls", _STATED.cart_pole(horizon=horizon))


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
