"""Inertias at and beyond the triangle inequality: MuJoCo takes what is made of them."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.attributes import write_inertial
from climbplan.simulation.physical_inertia import repair_inertia


def turned(moments: list[float], rng: np.random.Generator) -> Array:
    turn = rotation_world_body(rng.uniform(-3, 3, 3))
    return np.asarray(turn @ np.diag(moments) @ turn.T)


def compiled(inertia: Array) -> Array:
    """Principal moments that MuJoCo reads."""
    xml = write_inertial(0.1, np.zeros(3), inertia, "link")
    model = f"<mujoco><worldbody><body>{xml}<freejoint/></body></worldbody></mujoco>"
    return np.sort(mujoco.MjModel.from_xml_string(model).body_inertia[1])


def test_plates_are_simulated_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    """Their largest moment is the sum of the others, which rounding puts on either side."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        one, other = np.sort(rng.uniform(1e-6, 1e-4, 2))
        found = compiled(turned([one, other, one + other], rng))
        np.testing.assert_allclose(found, [one, other, one + other], rtol=1e-4)
    assert not caplog.records


def test_what_no_body_can_have_is_repaired_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(1)
    with caplog.at_level(logging.WARNING):
        for _ in range(20):
            found = compiled(turned([1e-5, 2e-5, 5e-5], rng))
            assert found[0] + found[1] >= found[2]
            # S = diag(3, 2, -1) 1e-5 without its negative part
            np.testing.assert_allclose(found, [2e-5, 3e-5, 5e-5], rtol=1e-4)
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["link"]


def test_bodies_keep_their_inertia_and_points_get_a_little() -> None:
    inertia = turned([2e-3, 3e-3, 4e-3], np.random.default_rng(2))
    np.testing.assert_allclose(repair_inertia(inertia, "cube"), inertia, rtol=1e-15)
    assert compiled(np.zeros((3, 3)))[0] > 0
