"""Toes slide into other surfaces, and are held in corners."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import SLIDES
from climbplan.climb.simulation.implicit_dynamics.corner_contact import (
    _find_obstacle_hit,
    _project_to_cone,
)
from climbplan.climb.simulation.implicit_dynamics.state import (
    ContactSolution,
    ContactState,
    TerrainGeometry,
)


@compiled
def run_into(
    contacts: ContactState, ground: TerrainGeometry, solution: ContactSolution
) -> tuple[int, int, float]:
    """`_runs_into` of the first toe."""
    return _find_obstacle_hit(0, contacts, ground, solution)


@compiled
def onto_cone(vector: Array, normal: Array, mu: float, out: Array) -> None:
    """`_onto_cone`."""
    _project_to_cone(vector, normal, mu, out)


def box(low: list[float], high: list[float]) -> Array:
    """(6, 4) rows of an axis-aligned box."""
    sides = np.vstack([np.eye(3), -np.eye(3)])
    return np.hstack([sides, np.concatenate([high, np.negative(low)])[:, None]])


def slid(before: list[float], now: list[float]) -> tuple[ContactState, ContactSolution]:
    """A toe that has slid from one place on the floor to another."""
    one, flags = np.zeros(1, np.int64), np.zeros(1, np.int64)
    contacts = ContactState(
        np.ones(1, np.int64), one, one + 2, np.array([before]), flags,
        np.full((1, 2), -1),
    )  # fmt: skip
    solution = ContactSolution(
        np.full(1, SLIDES), one, one + 2, np.array([now]), np.array([[0.0, 0.0, 1.0]]),
        np.zeros((1, 3)), np.zeros((1, 3)), flags,
    )  # fmt: skip
    return contacts, solution


def test_a_toe_that_slides_into_a_wall_stops_at_it() -> None:
    floor = box([-1.0, -1.0, -0.1], [1.0, 1.0, 0.0])
    wall = box([0.5, -1.0, -0.1], [1.0, 1.0, 1.0])
    ground = TerrainGeometry(np.stack([floor, wall]), np.ones(2), np.zeros((0, 5)), np.zeros(0))
    solid, face, deep = run_into(*_with(ground, slid([0.49, 0.0, 0.0], [0.52, 0.0, 0.0])))
    assert (solid, face) == (1, 3)  # the side that looks to -x
    assert deep == pytest.approx(0.02, abs=2e-5)
    assert run_into(*_with(ground, slid([0.4, 0.0, 0.0], [0.45, 0.0, 0.0])))[0] == -1


def _with(
    ground: TerrainGeometry, toe: tuple[ContactState, ContactSolution]
) -> tuple[ContactState, TerrainGeometry, ContactSolution]:
    return toe[0], ground, toe[1]


@pytest.mark.parametrize(
    ("force", "expected"),
    [
        ([0.3, 0.0, 1.0], [0.3, 0.0, 1.0]),  # inside
        ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0]),  # pulled
        ([1.0, 0.0, 1.0], [0.6, 0.0, 1.2]),  # beyond its edge, mu 0.5
    ],
)
def test_forces_go_to_the_nearest_of_a_cone(force: list[float], expected: list[float]) -> None:
    out = np.zeros(3)
    onto_cone(np.array(force), np.array([0.0, 0.0, 1.0]), 0.5, out)
    assert out == pytest.approx(expected)
