"""A spherical foot that rolls moves its centre and slides nowhere."""

from __future__ import annotations

import numpy as np

from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.measures import integrate_rolling

RADIUS = 0.02


def test_a_foot_that_tips_rolls_by_radius_times_angle() -> None:
    angle = np.linspace(0.0, 0.5, 101)
    links = rotation_world_body(np.stack([0 * angle, angle, 0 * angle], axis=-1))
    moved = integrate_rolling(RADIUS, links, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(moved[:, 0], RADIUS * angle, atol=1e-6)  # about y, towards x
    np.testing.assert_allclose(moved[:, 1:], 0.0, atol=1e-12)


def test_a_foot_that_spins_on_the_spot_stays() -> None:
    angle = np.linspace(0.0, 1.0, 101)
    links = rotation_world_body(np.stack([0 * angle, 0 * angle, angle], axis=-1))
    np.testing.assert_allclose(
        integrate_rolling(RADIUS, links, np.array([0.0, 0.0, 1.0])), 0.0, atol=1e-12
    )
