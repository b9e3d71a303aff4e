"""Walls that move: the plant beside the statement's model, and a controller of some ticks."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.engine.moving_walls import STIFFNESS, TICK, WALLS, Plant
from benchmarks.engine.shipped import shipped_cart_pole
from benchmarks.engine.ticks import controlled

_STATED = shipped_cart_pole()
A, B, E = _STATED.A, _STATED.B, _STATED.E


def test_a_small_motion_is_that_of_the_plans_model() -> None:
    plant = Plant(0)
    state = np.array([0.01, 0.02, 0.03, -0.02])
    plant.state = state
    plant.tick(0.5)
    model = A @ state + B[:, 0] * 0.5
    moved = np.abs(plant.state - state).max()
    assert np.abs(plant.state - model).max() < 0.06 * moved


def test_a_wall_pushes_the_tip_back_as_the_model_has_it() -> None:
    def after(tip: float) -> float:
        plant = Plant(0)
        plant.state = np.array([tip, 0.0, 0.0, 0.0])
        plant.tick(0.0)
        return float(plant.state[3])

    gained = after(WALLS[0] + 0.1) - after(0.0)  # the tip goes left, the angle to the left grows
    assert gained == pytest.approx(E[3, 0] * STIFFNESS * 0.1, rel=0.15)  # the wall moves a little
    assert after(-WALLS[1] - 0.1) - after(0.0) == pytest.approx(-gained, rel=0.15)


def test_a_controller_of_some_ticks_keeps_the_pole_up_within_its_work() -> None:
    ticks, again = controlled(6, 3, 1.0), controlled(6, 3, 1.0)
    assert len(ticks.spent) == round(1.0 / TICK)
    assert ticks.falls == 0
    assert ticks.status["optimal"] > 0.9 * len(ticks.spent)
    assert max(ticks.off) < 2e-3
    assert (ticks.nodes, ticks.gap, ticks.status) == (again.nodes, again.gap, again.status)
