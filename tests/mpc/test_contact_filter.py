"""The state estimate: rotations, sensors, consistency of the covariance, and bad measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from climbplan.mpc.estimation.contact_filter import PLACE, SIZE, ContactFilter, Prior
from climbplan.mpc.estimation.lie import euler, exponential, left_jacobian, logarithm
from climbplan.mpc.estimation.sensors import Readings, SensorNoise, Sensors
from climbplan.mpc.task import Array, Flags
from climbplan.robots.rotations import rotation_world_body

DT, GRAVITY = 0.005, 9.81
HIPS = np.array([[0.2, 0.158], [0.2, -0.158], [-0.2, 0.158], [-0.2, -0.158]])
QUIET = SensorNoise(0, 0, 0, 0, 0, encoder=1e-6, ground=1e-6)


@dataclass(frozen=True)
class Walk:
    """A trot whose body sways in all directions: states, toes and contacts at samples."""

    state: Array  # (T, 12)
    toes: Array  # (T, 4, 3)
    contact: Flags  # (T, 4)


def trot(seconds: float, rng: np.random.Generator, uneven: float = 0.0) -> Walk:
    t = DT * np.arange(round(seconds / DT) + 1)
    state = np.zeros((len(t), 12))
    for axis, (speed, size, rate) in enumerate(
        ((0.8, 0.02, 9.0), (0.0, 0.03, 5.0), (0.0, 0.01, 15.0))
    ):
        state[:, axis] = speed * t + size * np.sin(rate * t)
        state[:, 3 + axis] = speed + size * rate * np.cos(rate * t)
    state[:, 2] += 0.2
    state[:, 6:9] = np.column_stack(
        [0.08 * np.sin(7 * t), 0.1 * np.sin(6 * t + 1), 0.3 * np.sin(1.5 * t)]
    )
    toes, contact = np.zeros((len(t), 4, 3)), np.zeros((len(t), 4), bool)
    standing = np.column_stack([HIPS, uneven * rng.normal(size=4)])
    for k, now in enumerate(t):
        first = int(now / 0.08 + 1e-9) % 2 == 0
        contact[k] = [first, not first, not first, first]
        came_down = contact[k] & ~contact[k - 1] if k else np.zeros(4, bool)
        there = np.column_stack([state[k, :2] + HIPS, uneven * rng.normal(size=4)])
        standing = np.where(came_down[:, None], there, standing)
        hanging = state[k, :3] + np.column_stack([HIPS, np.full(4, -0.15)])
        toes[k] = np.where(contact[k][:, None], standing, hanging)
    return Walk(state, toes, contact)


def follow(
    walk: Walk, noise: SensorNoise, seed: int, ground: float | None
) -> tuple[ContactFilter, Array]:
    """The estimate after the walk, and its NEES at every sample on the way."""
    rng = np.random.default_rng(seed)
    sensors, prior = Sensors(noise, GRAVITY, rng), Prior()
    start = prior.draw(walk.state[0], rng) if noise is not QUIET else walk.state[0]
    estimate = ContactFilter(start, noise, prior, GRAVITY, ground)
    history, slip = [], np.zeros((4, 3))
    for k in range(1, len(walk.state)):
        stays = (walk.contact[k] & walk.contact[k - 1])[:, None]
        slip = np.where(stays, slip + noise.slip * np.sqrt(DT) * rng.normal(size=(4, 3)), 0.0)
        seen = sensors.read(
            walk.state[k - 1], walk.state[k], walk.toes[k] + slip, walk.contact[k], DT
        )
        estimate.step(seen, DT)
        history.append(estimate.nees(walk.state[k]) if noise is not QUIET else 0.0)
    return estimate, np.array(history)


def test_rotations_agree_with_scipy() -> None:
    rng = np.random.default_rng(1)
    for scale in (1e-9, 1e-4, 1.0, 3.1):
        phi = rng.normal(size=3)
        phi *= scale / np.linalg.norm(phi)
        R = exponential(phi)
        np.testing.assert_allclose(R, Rotation.from_rotvec(phi).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(logarithm(R), phi, atol=1e-9)
        off = 1e-6 * rng.normal(size=3)
        moved = logarithm(exponential(phi + off) @ R.T)
        np.testing.assert_allclose(moved, left_jacobian(phi) @ off, atol=2e-11)
    half = Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    np.testing.assert_allclose(np.abs(logarithm(half)), [0, np.pi, 0], atol=1e-9)
    angles = np.array([0.3, -0.7, 2.0])
    np.testing.assert_allclose(euler(rotation_world_body(angles)), angles)


def test_without_noise_it_follows_exactly() -> None:
    walk = trot(2.0, np.random.default_rng(0))
    estimate, _ = follow(walk, QUIET, 0, None)
    np.testing.assert_allclose(estimate.position, walk.state[-1, :3], atol=2e-4)
    np.testing.assert_allclose(estimate.velocity, walk.state[-1, 3:6], atol=2e-4)
    np.testing.assert_allclose(estimate.state[6:9], walk.state[-1, 6:9], atol=1e-4)


@pytest.mark.parametrize("ground", [0.0, None])
def test_covariance_is_consistent(ground: float | None) -> None:
    """Mean NEES of independent walks, at several times of them, is within its band."""
    runs, noise = 40, SensorNoise()
    found = []
    for seed in range(runs):
        walk = trot(0.8, np.random.default_rng(100 + seed), noise.ground)
        found.append(follow(walk, noise, seed, ground)[1])
    mean = np.mean(found, axis=0)
    low, high = chi2.ppf([0.025, 0.975], 9 * runs) / runs
    assert ((mean > low) & (mean < high)).mean() >= 0.95
    # The test can fail: errors half as large again, or two thirds, are outside.
    assert (1.5**2 * mean > high).all()
    assert (mean / 1.5**2 < low).all()


def test_it_beats_integration_and_knows_what_it_cannot_know() -> None:
    walk, noise = trot(3.0, np.random.default_rng(5)), SensorNoise()
    held, _ = follow(walk, noise, 3, None)
    in_the_air = replace(walk, contact=np.zeros_like(walk.contact))
    free, _ = follow(in_the_air, noise, 3, None)
    off = [np.linalg.norm(f.velocity - walk.state[-1, 3:6]) for f in (held, free)]
    assert off[0] < 0.08
    assert off[0] < off[1]
    spread = np.sqrt(np.diag(held.covariance[PLACE, PLACE]))
    assert spread[0] > 0.01  # nothing measures where it is
    level, _ = follow(walk, noise, 3, 0.0)
    assert level.covariance[8, 8] < held.covariance[8, 8]  # but height over the ground


def test_a_toe_that_slips_is_taken_anew() -> None:
    walk, noise = trot(0.4, np.random.default_rng(2)), SensorNoise()
    toes = walk.toes.copy()
    toes[20:, :, 0] += 0.15 * walk.contact[20:]  # all standing toes jump by 15 cm
    estimate, _ = follow(replace(walk, toes=toes), noise, 1, 0.0)
    assert estimate.slipped >= 2
    assert np.linalg.norm(estimate.velocity - walk.state[-1, 3:6]) < 0.15


def test_what_is_no_measurement_changes_nothing() -> None:
    walk = trot(0.1, np.random.default_rng(2))
    estimate, _ = follow(walk, SensorNoise(), 1, 0.0)
    before, spread = estimate.state, estimate.covariance.copy()
    good = Readings(np.zeros(3), np.array([0, 0, 9.81]), np.zeros((4, 3)), np.ones(4, bool))
    toes = np.zeros((4, 3))
    toes[2, 1] = np.inf
    for bad in (replace(good, gyro=np.array([0, np.nan, 0])), replace(good, toes=toes)):
        with pytest.raises(ValueError, match="not a number"):
            estimate.step(bad, DT)
    np.testing.assert_array_equal(estimate.state, before)
    np.testing.assert_array_equal(estimate.covariance, spread)
    assert estimate.covariance.shape == (SIZE, SIZE)
