"""State estimation from an IMU, encoders and contacts: a contact-aided extended Kalman filter.

The state of Bloesch et al. (2012): orientation, velocity and position of the body, positions of the
feet that stand, and biases of gyroscope and accelerometer. Errors are the right-invariant ones of
Hartley et al. (2018), so that where nothing is known (position and heading in the world) nothing is
ever learned by linearisation. With X the true and X^ the estimated pose, exp(xi) = X^ X^-1:

    R^ R' = exp(xi_R),  v^ - R^ R' v = xi_v,  p^ - R^ R' p = xi_p,  d^ - R^ R' d = xi_d,

and biases' errors are estimate minus truth. The order of errors is R, v, p, gyroscope,
accelerometer, d (feet).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body

TURN, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
_FEET = 15  # where the errors of feet begin
_UNKNOWN = 1e4  # [m^2] variance of a foot in the air
_NEARLY_ZERO = 1e-8  # [rad]
_SLIPPED = 21.1  # squared distance that one in 10,000 of three Gaussian numbers exceeds


@dataclass(frozen=True)
class SensorQuality:
    """Standard deviations of measurements, and how fast things drift; the values are assumed."""

    gyro: float = 0.01  # [rad/s] of each sample
    accel: float = 0.1  # [m/s^2] of each sample
    toe: float = 0.005  # [m] of each coordinate of a toe in the body, from the encoders
    toe_rate: float = 0.1  # [m/s] of each coordinate of a toe's velocity in the body; 0: not there
    gyro_drift: float = 1e-3  # [rad/s / sqrt s] random walk of the bias
    accel_drift: float = 1e-3  # [m/s^2 / sqrt s]
    slip: float = 0.01  # [m / sqrt s] of standing toes
    accel_range: float = 157.0  # [m/s^2] beyond, the accelerometer says this: 16 g


@dataclass(frozen=True)
class Sensed:
    """One sample of the sensors."""

    gyro: Array  # (3,) mean angular velocity since the last sample, body frame [rad/s]
    accel: Array  # (3,) mean specific force since the last sample, body frame then [m/s^2]
    toes: Array  # (L, 3) in the body frame, from joint angles [m]
    contact: BoolArray  # (L,) felt
    rate: Array  # (3,) angular velocity now, body frame, for whoever needs it at once [rad/s]
    toe_rate: Array | None = None  # (L, 3) of toes in the body frame now, from joint rates [m/s]


@dataclass(frozen=True)
class Beginning:
    """What is known before the first sample, and how well (standard deviations)."""

    state: Array  # (12,) position, velocity, Euler angles, angular velocity (not used)
    turn: float = 0.02  # [rad]
    velocity: float = 0.1  # [m/s]
    position: float = 0.0  # [m] the world frame may begin here
    gyro_bias: float = 0.01  # [rad/s]
    accel_bias: float = 0.05  # [m/s^2]


def foot(leg: int) -> slice:
    """Where the error of a foot is."""
    return slice(_FEET + 3 * leg, _FEET + 3 * leg + 3)


def _legs(chosen: BoolArray) -> list[int]:
    return [int(leg) for leg in np.flatnonzero(chosen)]


class ContactFilter:
    """The estimate and its covariance: `predict` with each IMU sample, `correct` with encoders.

    A foot that is seen where it cannot be has slipped: it is taken anew instead of being used.
    """

    def __init__(self, begin: Beginning, quality: SensorQuality, gravity: float, legs: int) -> None:
        self.size = _FEET + 3 * legs  # of the error
        self.quality = quality
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.R: Array = rotation_world_body(begin.state[6:9])
        self.v: Array = begin.state[3:6].copy()
        self.p: Array = begin.state[:3].copy()
        self.d: Array = np.zeros((legs, 3))
        self.gyro_bias, self.accel_bias = np.zeros(3), np.zeros(3)
        self.standing: BoolArray = np.zeros(legs, bool)
        self.slips = 0  # feet that were taken anew because they moved
        self.P = np.zeros((self.size, self.size))
        # Given as errors of velocity and position themselves, whose invariant errors turn with R.
        self._spread(TURN, begin.turn)
        self._spread(VELOCITY, begin.velocity)
        self._spread(POSITION, begin.position)
        self._spread(GYRO_BIAS, begin.gyro_bias)
        self._spread(ACCEL_BIAS, begin.accel_bias)
        turned = np.eye(self.size)
        turned[VELOCITY, TURN], turned[POSITION, TURN] = skew(self.v), skew(self.p)
        self.P = turned @ self.P @ turned.T
        for leg in range(legs):
            self._forget(leg)

    def predict(self, sensed: Sensed, dt: float) -> None:
        """Move on by the IMU, dt seconds since the last sample."""
        R = self.R
        turn = (sensed.gyro - self.gyro_bias) * dt
        force = sensed.accel - self.accel_bias
        a = R @ force + self.gravity
        A = np.zeros((self.size, self.size))
        A[VELOCITY, TURN] = skew(self.gravity)
        A[POSITION, VELOCITY] = np.eye(3)
        A[TURN, GYRO_BIAS] = -R
        A[VELOCITY, GYRO_BIAS], A[VELOCITY, ACCEL_BIAS] = -skew(self.v) @ R, -R
        A[POSITION, GYRO_BIAS] = -skew(self.p) @ R
        for leg in _legs(self.standing):
            A[foot(leg), GYRO_BIAS] = -skew(self.d[leg]) @ R
        step = np.eye(self.size) + dt * A
        step[POSITION, TURN] += 0.5 * dt**2 * A[VELOCITY, TURN]
        self.P = step @ self.P @ step.T + self._noise(sensed, dt)
        self.p = self.p + dt * self.v + 0.5 * dt**2 * a
        self.v = self.v + dt * a
        self.R = R @ exponential(turn)

    def correct(self, sensed: Sensed) -> None:
        """Legs' kinematics: standing feet are where they were, new ones where encoders say."""
        seen = np.isfinite(sensed.toes).all(axis=1) & sensed.contact
        for leg in _legs(self.standing & ~seen):
            self._forget(leg)
        for leg in _legs(self.standing & seen):
            if self._slipped(leg, sensed.toes[leg]):
                self.slips += 1
                self._forget(leg)
        old = _legs(self.standing & seen)
        if old:
            self._update(old, sensed.toes[old])
            if sensed.toe_rate is not None and self.quality.toe_rate > 0:
                self._still(sensed.toes[old], sensed.toe_rate[old], sensed.rate)
        for leg in _legs(seen & ~self.standing):
            self._stand(leg, sensed.toes[leg])

    def toes(self, sensed: Sensed) -> Array:
        """World positions (L, 3) of all toes: standing ones as estimated, others by encoders."""
        free: Array = self.p + sensed.toes @ self.R.T
        toes: Array = np.where(self.standing[:, None], self.d, free)
        return toes

    @property
    def speed_error(self) -> float:
        """Standard deviation of the worst component of the velocity [m/s]."""
        by = np.hstack([-skew(self.v), np.eye(3)])  # of errors of turn and velocity
        rows = np.r_[TURN, VELOCITY]
        spread = by @ self.P[np.ix_(rows, rows)] @ by.T
        return float(np.sqrt(np.diag(spread).max()))

    def _noise(self, sensed: Sensed, dt: float) -> Array:
        quality, R = self.quality, self.R
        # What was beyond the range is not known, along the axes where it was.
        beyond = np.abs(sensed.accel) >= quality.accel_range
        accel = np.where(beyond, quality.accel_range, quality.accel)
        by = np.zeros((self.size, 6))  # of the noise of both sensors, invariant as the errors
        by[TURN, :3], by[VELOCITY, :3] = R, skew(self.v) @ R
        by[POSITION, :3], by[VELOCITY, 3:] = skew(self.p) @ R, R
        by[POSITION, 3:] = 0.5 * dt * R
        for leg in _legs(self.standing):
            by[foot(leg), :3] = skew(self.d[leg]) @ R
        strength = np.concatenate([np.full(3, quality.gyro), accel]) ** 2 * dt**2
        noise = (by * strength) @ by.T
        for leg in _legs(self.standing):
            noise[foot(leg), foot(leg)] += quality.slip**2 * dt * np.eye(3)
        noise[GYRO_BIAS, GYRO_BIAS] += quality.gyro_drift**2 * dt * np.eye(3)
        noise[ACCEL_BIAS, ACCEL_BIAS] += quality.accel_drift**2 * dt * np.eye(3)
        return noise

    def _slipped(self, leg: int, toe: Array) -> bool:
        """Whether a standing foot is where it cannot be, by its own covariance."""
        here = foot(leg)
        off = self.R @ toe - (self.d[leg] - self.p)
        P = self.P
        spread = P[POSITION, POSITION] - P[POSITION, here] - P[here, POSITION] + P[here, here]
        spread = spread + self.quality.toe**2 * np.eye(3)
        return bool(off @ np.linalg.solve(spread, off) > _SLIPPED)

    def _update(self, legs: list[int], toes: Array) -> None:
        """Innovation R^ s - (d^ - p^) = xi_p - xi_d + R^ n of standing legs' toes s (L, 3)."""
        count = len(legs)
        innovation = (toes @ self.R.T - (self.d[legs] - self.p)).ravel()
        H = np.zeros((3 * count, self.size))
        for k, leg in enumerate(legs):
            rows = slice(3 * k, 3 * k + 3)
            H[rows, POSITION], H[rows, foot(leg)] = np.eye(3), -np.eye(3)
        variance = self.quality.toe**2
        self._learn(innovation, H, variance)

    def _still(self, toes: Array, rates: Array, rate: Array) -> None:
        """Standing toes (L, 3) do not move: R^ (s' + w x s) + v^ = xi_v + noise.

        A push that the accelerometer has no range for shows here with the next sample. rates (L, 3)
        of toes in the body; rate (3,) of the body, whose bias counts by the toes' distances. Legs
        that move as none that stands would are left out: they slip.
        """
        spin = rate - self.gyro_bias
        innovation = (rates + np.cross(spin, toes)) @ self.R.T + self.v
        variance = self.quality.toe_rate**2
        spread = self.P[VELOCITY, VELOCITY] + variance * np.eye(3)
        off = np.einsum("li,ij,lj->l", innovation, np.linalg.inv(spread), innovation)
        still = np.flatnonzero(off <= _SLIPPED)
        H = np.zeros((3 * len(still), self.size))
        for k, leg in enumerate(still):
            rows = slice(3 * k, 3 * k + 3)
            H[rows, VELOCITY], H[rows, GYRO_BIAS] = np.eye(3), self.R @ skew(toes[leg])
        if len(still):
            self._learn(innovation[still].ravel(), H, variance)

    def _learn(self, innovation: Array, H: Array, variance: float) -> None:
        """Kalman's update (Joseph's form) by innovation = H xi + noise of one variance each."""
        PH = self.P @ H.T
        innovated = H @ PH + variance * np.eye(len(H))
        gain: Array = np.linalg.solve(innovated, PH.T).T.astype(float)
        left = np.eye(self.size) - gain @ H
        self.P = left @ self.P @ left.T + variance * gain @ gain.T
        self.P = 0.5 * (self.P + self.P.T)
        self._shift(-gain @ innovation)

    def _shift(self, xi: Array) -> None:
        """X^ becomes exp(xi) X^; biases are added to."""
        turn, spread = exponential(xi[TURN]), left_jacobian(xi[TURN])
        self.R = turn @ self.R
        self.v = turn @ self.v + spread @ xi[VELOCITY]
        self.p = turn @ self.p + spread @ xi[POSITION]
        for leg in _legs(self.standing):
            self.d[leg] = turn @ self.d[leg] + spread @ xi[foot(leg)]
        self.gyro_bias = self.gyro_bias + xi[GYRO_BIAS]
        self.accel_bias = self.accel_bias + xi[ACCEL_BIAS]

    def _stand(self, leg: int, toe: Array) -> None:
        """A foot comes down where the encoders say: xi_d = xi_p + R^ n."""
        self.d[leg] = self.p + self.R @ toe
        here = foot(leg)
        self.P[here, :] = self.P[POSITION, :]
        self.P[:, here] = self.P[:, POSITION]
        self.P[here, here] = self.P[POSITION, POSITION] + self.quality.toe**2 * np.eye(3)
        self.standing[leg] = True

    def _forget(self, leg: int) -> None:
        here = foot(leg)
        self.P[here, :], self.P[:, here] = 0.0, 0.0
        self.P[here, here] = _UNKNOWN * np.eye(3)
        self.standing[leg] = False

    def _spread(self, where: slice, deviation: float) -> None:
        self.P[where, where] = deviation**2 * np.eye(3)


def skew(vector: Array) -> Array:
    """Matrix (3, 3) of the cross product with a vector (3,)."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(turn: Array) -> Array:
    """Rotation (3, 3) by a rotation vector (3,)."""
    angle = float(np.linalg.norm(turn))
    K = skew(turn)
    if angle < _NEARLY_ZERO:
        near: Array = np.eye(3) + K
        return near
    result: Array = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)
    return result


def logarithm(R: Array) -> Array:
    """Rotation vector (3,) of a rotation (3, 3) by less than half a turn."""
    twice = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = 0.5 * float(np.linalg.norm(twice)), 0.5 * (float(np.trace(R)) - 1)
    angle = float(np.arctan2(sine, cosine))
    vector: Array = 0.5 * twice if sine < _NEARLY_ZERO else angle / (2 * sine) * twice
    return vector


def left_jacobian(turn: Array) -> Array:
    """Of the rotation group, (3, 3): exp(turn + small) = exp(J small) exp(turn)."""
    angle = float(np.linalg.norm(turn))
    K = skew(turn)
    if angle < 1e-4:
        near: Array = np.eye(3) + 0.5 * K
        return near
    result: Array = (
        np.eye(3)
        + (1 - np.cos(angle)) / angle**2 * K
        + (angle - np.sin(angle)) / angle**3 * (K @ K)
    )
    return result
