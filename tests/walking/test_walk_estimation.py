"""The contact-aided filter: errors against simulated truth, and a covariance that means it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.online.estimation import (
    ACCEL_BIAS,
    GYRO_BIAS,
    ORIENTATION,
    POSITION,
    VELOCITY,
    ContactAidedEkf,
    InitialEstimate,
    SensorQuality,
    SensorSample,
    exponential,
    foot_slice,
    left_jacobian,
    logarithm,
)
from climbplan.walking.online.state_feedback import SimulatedSensors

DT, GRAVITY = 0.005, 9.81
QUALITY = SensorQuality()
HIPS = np.array([[0.2, 0.16, -0.2], [0.2, -0.16, -0.2], [-0.2, 0.16, -0.2], [-0.2, -0.16, -0.2]])
KNOT = 16  # samples
RUNS, SAMPLES = 50, 160  # 0.8 s


@dataclass
class Truth:
    """A body that sways at 1 m/s above trotting feet, which slip a little."""

    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.phase = self.rng.uniform(0, 6, 6)
        self.toes = self._under(0)

    def state(self, k: int) -> Array:
        t = k * DT
        wave = np.sin(np.array([5.0, 6.0, 4.0, 7.0, 5.5, 3.0]) * t + self.phase)
        rate = np.cos(np.array([5.0, 6.0, 4.0, 7.0, 5.5, 3.0]) * t + self.phase)
        state = np.zeros(12)
        state[:3] = [t + 0.02 * wave[0], 0.02 * wave[1], 0.2 + 0.01 * wave[2]]
        state[3:6] = [1 + 0.1 * rate[0], 0.12 * rate[1], 0.04 * rate[2]]
        state[6:9] = 0.1 * wave[3:]
        return state

    def _under(self, k: int) -> Array:
        state = self.state(k)
        toes = state[:3] + HIPS @ rotation_world_body(state[6:9]).T
        return np.asarray(toes * [1, 1, 0])

    def contact(self, k: int) -> BoolArray:
        first = (k // KNOT) % 2 == 0
        return (
            np.array([True, True, True, True])
            if k < KNOT
            else np.array([first, not first, not first, first])
        )

    def feet(self, k: int, quality: SensorQuality) -> Array:
        """Toes at a sample; called once for each in turn."""
        stands = self.contact(k) & self.contact(k - 1)
        slip = quality.slip * np.sqrt(DT) * self.rng.normal(size=(4, 3))
        self.toes = np.where(stands[:, None], self.toes + slip, self._under(k))
        return self.toes


@dataclass(frozen=True)
class Run:
    """Errors at the end, their covariance, and how far off position and velocity ever were."""

    error: Array  # (27,)
    covariance: Array
    standing: BoolArray
    velocity: Array  # (K,) [m/s]
    height: Array  # (K,) [m] of the body above its feet
    drift: float  # [m]


def run(seed: int, quality: SensorQuality = QUALITY) -> Run:
    rng = np.random.default_rng([11, seed])
    truth = Truth(rng)
    sensors = SimulatedSensors(QUALITY, GRAVITY, rng)
    begin = truth.state(0)
    known = begin.copy()
    turned = exponential(0.02 * rng.normal(size=3)) @ rotation_world_body(begin[6:9])
    known[6:9] = [
        np.arctan2(turned[2, 1], turned[2, 2]),
        np.arcsin(-turned[2, 0]),
        np.arctan2(turned[1, 0], turned[0, 0]),
    ]
    known[3:6] += 0.1 * rng.normal(size=3)
    known[:3] += 0.01 * rng.normal(size=3)
    # What the filter is told of its beginning holds of the errors as they are drawn here.
    filter_ = ContactAidedEkf(InitialEstimate(known, position=0.01), quality, GRAVITY, 4)
    off, height = [], []
    for k in range(1, SAMPLES + 1):
        toes = truth.feet(k, QUALITY)
        sensed = sensors.sample(truth.state(k - 1), truth.state(k), toes, truth.contact(k), DT)
        filter_.predict(sensed, DT)
        filter_.update(sensed)
        state = truth.state(k)
        R = rotation_world_body(state[6:9])
        off.append(np.linalg.norm(filter_.R.T @ filter_.v - R.T @ state[3:6]))
        stand = filter_.standing
        above = filter_.p[2] - filter_.d[stand, 2].mean()
        height.append(above - (state[2] - toes[stand, 2].mean()))
    error = np.zeros(filter_.error_size)
    turn = filter_.R @ R.T
    spread = np.linalg.inv(left_jacobian(logarithm(turn)))
    error[ORIENTATION] = logarithm(turn)
    error[VELOCITY] = spread @ (filter_.v - turn @ state[3:6])
    error[POSITION] = spread @ (filter_.p - turn @ state[:3])
    for leg in range(4):
        error[foot_slice(leg)] = spread @ (filter_.d[leg] - turn @ toes[leg])
    error[GYRO_BIAS] = filter_.gyro_bias - sensors.gyro_bias
    error[ACCEL_BIAS] = filter_.accel_bias - sensors.accel_bias
    drift = float(np.linalg.norm(filter_.p - state[:3]))
    return Run(error, filter_.P, filter_.standing, np.array(off), np.array(height), drift)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return [run(seed) for seed in range(RUNS)]


def nees(one: Run, observable: bool) -> tuple[float, int]:
    """Normalised squared error of legs that stand and all else, and its degrees of freedom.

    observable: without shifts of the whole world and turns about the vertical, which nothing
    that is measured can tell.
    """
    places = np.arange(len(one.error))
    feet = [places[foot_slice(int(leg))] for leg in np.flatnonzero(one.standing)]
    kept = np.concatenate([places[: foot_slice(0).start], *feet])
    error, P = one.error[kept], one.covariance[np.ix_(kept, kept)]
    if observable:
        unknown = np.zeros((len(one.error), 4))
        unknown[2, 0] = 1.0
        for place in (POSITION, *map(foot_slice, range(4))):
            unknown[place, 1:] = np.eye(3)
        basis = np.linalg.qr(unknown[kept], mode="complete")[0][:, 4:]
        error, P = basis.T @ error, basis.T @ P @ basis
    return float(error @ np.linalg.solve(P, error)), len(error)


@pytest.mark.parametrize("observable", [True, False])
def test_covariance_is_consistent(runs: list[Run], observable: bool) -> None:
    """The mean NEES of independent runs is within the 95 % band of its chi-square law."""
    values, freedom = zip(*(nees(one, observable) for one in runs), strict=True)
    band = chi2.ppf([0.025, 0.975], sum(freedom))
    assert band[0] < sum(values) < band[1]


def test_errors_against_the_truth(runs: list[Run]) -> None:
    """Velocity in the body, height above the feet, and how far the position drifts."""
    velocity = np.stack([one.velocity for one in runs])[:, SAMPLES // 2 :]
    height = np.stack([one.height for one in runs])[:, SAMPLES // 2 :]
    assert np.sqrt((velocity**2).mean()) < 0.06
    assert np.sqrt((height**2).mean()) < 0.003
    assert np.median([one.drift for one in runs]) < 0.06


def test_overconfidence_is_found() -> None:
    """The same filter that believes its encoders five times too much fails the same band."""
    sure = [run(seed, SensorQuality(toe=QUALITY.toe / 5)) for seed in range(4)]
    values, freedom = zip(*(nees(one, observable=True) for one in sure), strict=True)
    assert sum(values) > chi2.ppf(0.975, sum(freedom))


def test_nothing_is_learned_of_heading_and_place() -> None:
    one = run(0)
    heading = np.sqrt(one.covariance[2, 2])
    assert heading > 0.02  # what it was at first, and the gyroscope's drift since
    assert np.sqrt(one.covariance[6, 6]) > 0.01


def test_a_foot_in_the_air_or_unseen_is_not_trusted() -> None:
    truth = Truth(np.random.default_rng(0))
    filter_ = ContactAidedEkf(InitialEstimate(truth.state(0)), QUALITY, GRAVITY, 4)
    seen = HIPS.copy()
    three, none = np.array([1, 1, 1, 0], bool), np.zeros(3)
    still = SensorSample(none, np.array([0, 0, GRAVITY]), seen, three, none)
    filter_.update(still)
    assert filter_.standing.tolist() == [True, True, True, False]
    seen = seen.copy()
    seen[1] = np.nan
    filter_.update(SensorSample(none, still.accel, seen, np.ones(4, bool), none))
    assert filter_.standing.tolist() == [True, False, True, True]
    assert np.isfinite(filter_.P).all()
    assert np.linalg.eigvalsh(filter_.P).min() > -1e-9


def test_a_foot_that_slips_is_taken_anew() -> None:
    """One foot slides away by 5 cm: the velocity is not dragged along."""
    state = np.zeros(12)
    state[2] = 0.2
    for jumps, slips in ((0.0, 0), (0.05, 1)):
        sensors = SimulatedSensors(QUALITY, GRAVITY, np.random.default_rng(5))
        filter_ = ContactAidedEkf(InitialEstimate(state), QUALITY, GRAVITY, 4)
        toes = state[:3] + HIPS
        for k in range(60):
            if k == 40:
                toes[1, 0] += jumps
            sensed = sensors.sample(state, state, toes, np.ones(4, bool), DT)
            filter_.predict(sensed, DT)
            filter_.update(sensed)
        assert filter_.num_slips == slips
        assert np.linalg.norm(filter_.v) < 0.05


@pytest.mark.parametrize("toe_rate", [0.0, QUALITY.foot_velocity_std])
def test_a_blow_beyond_the_accelerometers_range_is_caught_by_the_legs(toe_rate: float) -> None:
    """By where toes are within 200 ms; by joint velocities with the next sample: along its axis."""
    quality = SensorQuality(foot_velocity_std=toe_rate)
    rng = np.random.default_rng(2)
    sensors = SimulatedSensors(quality, GRAVITY, rng)
    state = np.zeros(12)
    state[2] = 0.2
    filter_ = ContactAidedEkf(InitialEstimate(state), quality, GRAVITY, 4)
    toes = state[:3] + HIPS
    for k in range(60):
        before = state.copy()
        if k == 20:
            state[3] -= 1.5
        state[:3] += DT * state[3:6]
        sensed = sensors.sample(before, state, toes, np.ones(4, bool), DT)
        filter_.predict(sensed, DT)
        filter_.update(sensed)
        if k == 20:
            off = abs(filter_.v[0] + 1.5)
            assert off < 0.2 if toe_rate else off > 0.2  # half of it was beyond the range
            assert (filter_.velocity_std < 0.1) == (toe_rate > 0)
            # Along the other axes the accelerometer was within its range, and is believed
            spread = np.sqrt(np.diag(filter_.P[VELOCITY, VELOCITY]))
            assert (spread[1:] < 0.03).all()  # 0.05 or 0.6 if they were not
            assert np.abs(filter_.v[1:]).max() < 0.03
    assert abs(filter_.v[0] + 1.5) < 0.1


def test_a_leg_that_slides_does_not_tell_of_the_velocity() -> None:
    state = np.zeros(12)
    state[2] = 0.2
    sensors = SimulatedSensors(QUALITY, GRAVITY, np.random.default_rng(3))
    filter_ = ContactAidedEkf(InitialEstimate(state), QUALITY, GRAVITY, 4)
    toes = state[:3] + HIPS
    for k in range(60):
        sensed = sensors.sample(state, state, toes, np.ones(4, bool), DT)
        assert sensed.toe_velocity is not None
        if k == 40:
            sensed.toe_velocity[1, 0] += 3.0  # of the leg alone, within less than a sample's way
        filter_.predict(sensed, DT)
        filter_.update(sensed)
        assert k < 40 or np.linalg.norm(filter_.v) < 0.06


def test_exponential_and_logarithm() -> None:
    for turn in np.random.default_rng(1).normal(size=(5, 3)):
        np.testing.assert_allclose(logarithm(exponential(turn)), turn, atol=1e-12)
        small = 1e-6 * np.array([1.0, -2.0, 0.5])
        both = logarithm(exponential(turn + small) @ exponential(-turn))
        np.testing.assert_allclose(both, left_jacobian(turn) @ small, atol=1e-11)
