"""State estimation from IMU, encoders and contacts by an extended Kalman filter (EKF).

The state is that of Bloesch et al. (2012): orientation, velocity and position of the body,
positions of the standing feet, and biases of gyroscope and accelerometer. Errors are the
right-invariant ones of Hartley et al. (2018). Unobservable directions (position and heading in the
world) therefore stay unobservable after linearisation. With X the true and X^ the estimated pose,
exp(xi) = X^ X^-1:

    R^ R' = exp(xi_R),  v^ - R^ R' v = xi_v,  p^ - R^ R' p = xi_p,  d^ - R^ R' d = xi_d,

and errors of the biases are estimate minus truth. The order of errors is R, v, p, gyroscope,
accelerometer, d (feet).

References:
    Bloesch et al. (2012), "State estimation for legged robots: consistent fusion of leg kinematics
    and IMU"; Hartley et al. (2018), "Contact-aided invariant extended Kalman filtering for legged
    robot state estimation".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body

ORIENTATION, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
_FIRST_FOOT = 15  # index of the first foot's error
_AIRBORNE_VARIANCE = 1e4  # [m^2] of each coordinate of a foot in the air
_SMALL_ANGLE = 1e-8  # [rad]
_CHI_SQUARE_GATE = 21.1  # quantile 0.9999 of chi-square with three degrees of freedom


@dataclass(frozen=True)
class SensorQuality:
    """Standard deviations and drifts of the sensors; the default values are assumptions."""

    gyro: float = 0.01  # [rad/s] of each sample
    accel: float = 0.1  # [m/s^2] of each sample
    toe: float = 0.005  # [m] of each coordinate of a toe in the body, from the encoders
    # [m/s] of each coordinate of a toe's velocity in the body; 0: no sensor
    foot_velocity_std: float = 0.1
    gyro_drift: float = 1e-3  # [rad/s / sqrt s] random walk of the bias
    accel_drift: float = 1e-3  # [m/s^2 / sqrt s]
    slip: float = 0.01  # [m / sqrt s] of standing toes
    accel_range: float = 157.0  # [m/s^2] at which the accelerometer saturates: 16 g


@dataclass(frozen=True)
class SensorSample:
    """One sample of the sensors: IMU, joint encoders and contact switches."""

    gyro: Array  # (3,) mean angular velocity since the last sample, body frame [rad/s]
    accel: Array  # (3,) mean specific force since the last sample, body frame then [m/s^2]
    toes: Array  # (L, 3) in the body frame, from joint angles [m]
    contact: BoolArray  # (L,) contact is detected
    angular_rate: Array  # (3,) instantaneous, body frame [rad/s]
    toe_velocity: Array | None = None  # (L, 3) body frame, from joint rates [m/s]


@dataclass(frozen=True)
class InitialEstimate:
    """The estimate before the first sample, with its standard deviations."""

    state: Array  # (12,) position, velocity, Euler angles, angular velocity (not used)
    orientation: float = 0.02  # [rad]
    velocity: float = 0.1  # [m/s]
    position: float = 0.0  # [m] zero: the world frame is defined by the first estimate
    gyro_bias: float = 0.01  # [rad/s]
    accel_bias: float = 0.05  # [m/s^2]


def foot_slice(leg: int) -> slice:
    """Return the rows of a foot's position in the error state."""
    return slice(_FIRST_FOOT + 3 * leg, _FIRST_FOOT + 3 * leg + 3)


def _indices(mask: BoolArray) -> list[int]:
    """Return the indices of the legs that a mask (L,) selects."""
    return [int(leg) for leg in np.flatnonzero(mask)]


class ContactAidedEkf:
    """A right-invariant EKF: `predict` with each IMU sample, `update` with encoders and contacts.

    Feet whose innovation fails a chi-square test have slipped: their positions are initialised
    again instead of being used.
    """

    def __init__(
        self, initial: InitialEstimate, quality: SensorQuality, gravity: float, num_legs: int
    ) -> None:
        """Initialise the filter.

        Args:
            initial: state and standard deviations before the first sample.
            quality: noise of the sensors.
            gravity: magnitude of the gravitational acceleration [m/s^2].
            num_legs: number L of legs.
        """
        self.error_size = _FIRST_FOOT + 3 * num_legs  # of the error
        self.quality = quality
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.R: Array = rotation_world_body(initial.state[6:9])
        self.v: Array = initial.state[3:6].copy()
        self.p: Array = initial.state[:3].copy()
        self.d: Array = np.zeros((num_legs, 3))
        self.gyro_bias, self.accel_bias = np.zeros(3), np.zeros(3)
        self.standing: BoolArray = np.zeros(num_legs, bool)
        self.num_slips = 0  # of feet that were initialised again
        self.P = np.zeros((self.error_size, self.error_size))
        # Map standard deviations of velocity and position to invariant errors.
        self._set_variance(ORIENTATION, initial.orientation)
        self._set_variance(VELOCITY, initial.velocity)
        self._set_variance(POSITION, initial.position)
        self._set_variance(GYRO_BIAS, initial.gyro_bias)
        self._set_variance(ACCEL_BIAS, initial.accel_bias)
        to_invariant = np.eye(self.error_size)
        to_invariant[VELOCITY, ORIENTATION], to_invariant[POSITION, ORIENTATION] = (
            skew(self.v),
            skew(self.p),
        )
        self.P = to_invariant @ self.P @ to_invariant.T
        for leg in range(num_legs):
            self._reset_foot(leg)

    def predict(self, sample: SensorSample, dt: float) -> None:
        """Propagate mean and covariance by one IMU sample over dt seconds."""
        R = self.R
        rotation = (sample.gyro - self.gyro_bias) * dt
        specific_force = sample.accel - self.accel_bias
        acceleration = R @ specific_force + self.gravity
        A = np.zeros((self.error_size, self.error_size))
        A[VELOCITY, ORIENTATION] = skew(self.gravity)
        A[POSITION, VELOCITY] = np.eye(3)
        A[ORIENTATION, GYRO_BIAS] = -R
        A[VELOCITY, GYRO_BIAS], A[VELOCITY, ACCEL_BIAS] = -skew(self.v) @ R, -R
        A[POSITION, GYRO_BIAS] = -skew(self.p) @ R
        for leg in _indices(self.standing):
            A[foot_slice(leg), GYRO_BIAS] = -skew(self.d[leg]) @ R
        transition = np.eye(self.error_size) + dt * A
        transition[POSITION, ORIENTATION] += 0.5 * dt**2 * A[VELOCITY, ORIENTATION]
        self.P = transition @ self.P @ transition.T + self._compute_process_noise(sample, dt)
        self.p = self.p + dt * self.v + 0.5 * dt**2 * acceleration
        self.v = self.v + dt * acceleration
        self.R = R @ exponential(rotation)

    def update(self, sample: SensorSample) -> None:
        """Correct the estimate by leg kinematics and initialise feet that just touched down."""
        observed = np.isfinite(sample.toes).all(axis=1) & sample.contact
        for leg in _indices(self.standing & ~observed):
            self._reset_foot(leg)
        for leg in _indices(self.standing & observed):
            if self._detect_slip(leg, sample.toes[leg]):
                self.num_slips += 1
                self._reset_foot(leg)
        persistent = _indices(self.standing & observed)
        if persistent:
            self._update_positions(persistent, sample.toes[persistent])
            if sample.toe_velocity is not None and self.quality.foot_velocity_std > 0:
                self._update_zero_velocity(
                    sample.toes[persistent], sample.toe_velocity[persistent], sample.angular_rate
                )
        for leg in _indices(observed & ~self.standing):
            self._initialise_foot(leg, sample.toes[leg])

    def compute_toes(self, sample: SensorSample) -> Array:
        """Return world positions (L, 3) of all toes [m].

        Standing toes are at their estimated positions, others where the encoders place them.
        """
        from_encoders: Array = self.p + sample.toes @ self.R.T
        toes: Array = np.where(self.standing[:, None], self.d, from_encoders)
        return toes

    @property
    def velocity_std(self) -> float:
        """Largest standard deviation of a component of the velocity [m/s]."""
        # Maps errors of orientation and velocity
        projection = np.hstack([-skew(self.v), np.eye(3)])
        rows = np.r_[ORIENTATION, VELOCITY]
        covariance = projection @ self.P[np.ix_(rows, rows)] @ projection.T
        return float(np.sqrt(np.diag(covariance).max()))

    def _compute_process_noise(self, sample: SensorSample, dt: float) -> Array:
        """Return the discrete-time process noise covariance of one IMU sample."""
        quality, R = self.quality, self.R
        # A saturated axis carries no information: inflate its noise.
        saturated = np.abs(sample.accel) >= quality.accel_range
        accel = np.where(saturated, quality.accel_range, quality.accel)
        noise_map = np.zeros((self.error_size, 6))  # from IMU noise to invariant errors
        noise_map[ORIENTATION, :3], noise_map[VELOCITY, :3] = R, skew(self.v) @ R
        noise_map[POSITION, :3], noise_map[VELOCITY, 3:] = skew(self.p) @ R, R
        noise_map[POSITION, 3:] = 0.5 * dt * R
        for leg in _indices(self.standing):
            noise_map[foot_slice(leg), :3] = skew(self.d[leg]) @ R
        variance = np.concatenate([np.full(3, quality.gyro), accel]) ** 2 * dt**2
        noise = (noise_map * variance) @ noise_map.T
        for leg in _indices(self.standing):
            noise[foot_slice(leg), foot_slice(leg)] += quality.slip**2 * dt * np.eye(3)
        noise[GYRO_BIAS, GYRO_BIAS] += quality.gyro_drift**2 * dt * np.eye(3)
        noise[ACCEL_BIAS, ACCEL_BIAS] += quality.accel_drift**2 * dt * np.eye(3)
        return noise

    def _detect_slip(self, leg: int, toe: Array) -> bool:
        """Return whether a standing foot's innovation fails the chi-square test."""
        foot_rows = foot_slice(leg)
        residual = self.R @ toe - (self.d[leg] - self.p)
        P = self.P
        covariance = (
            P[POSITION, POSITION]
            - P[POSITION, foot_rows]
            - P[foot_rows, POSITION]
            + P[foot_rows, foot_rows]
        )
        covariance = covariance + self.quality.toe**2 * np.eye(3)
        return bool(residual @ np.linalg.solve(covariance, residual) > _CHI_SQUARE_GATE)

    def _update_positions(self, legs: list[int], toes: Array) -> None:
        """Apply the measurement update of toes (K, 3): R^ s - (d^ - p^) = xi_p - xi_d + R^ n.

        s are toe positions in the body frame from the encoders.
        """
        num_feet = len(legs)
        innovation = (toes @ self.R.T - (self.d[legs] - self.p)).ravel()
        H = np.zeros((3 * num_feet, self.error_size))
        for k, leg in enumerate(legs):
            rows = slice(3 * k, 3 * k + 3)
            H[rows, POSITION], H[rows, foot_slice(leg)] = np.eye(3), -np.eye(3)
        variance = self.quality.toe**2
        self._apply_kalman_update(innovation, H, variance)

    def _update_zero_velocity(
        self, toes: Array, toe_velocities: Array, angular_rate: Array
    ) -> None:
        """Apply the zero-velocity update of standing toes: R^ (s' + w x s) + v^ = xi_v + noise.

        A push beyond the accelerometer's range becomes visible here with the next sample. Toes
        that fail the chi-square test slip and are left out.

        Args:
            toes: (K, 3) positions of standing toes in the body [m].
            toe_velocities: (K, 3) their velocities in the body [m/s].
            angular_rate: (3,) of the body; its bias counts by the toes' distances [rad/s].
        """
        angular_velocity = angular_rate - self.gyro_bias
        innovation = (toe_velocities + np.cross(angular_velocity, toes)) @ self.R.T + self.v
        variance = self.quality.foot_velocity_std**2
        covariance = self.P[VELOCITY, VELOCITY] + variance * np.eye(3)
        squared_distance = np.einsum(
            "li,ij,lj->l", innovation, np.linalg.inv(covariance), innovation
        )
        accepted = np.flatnonzero(squared_distance <= _CHI_SQUARE_GATE)
        H = np.zeros((3 * len(accepted), self.error_size))
        for k, leg in enumerate(accepted):
            rows = slice(3 * k, 3 * k + 3)
            H[rows, VELOCITY], H[rows, GYRO_BIAS] = np.eye(3), self.R @ skew(toes[leg])
        if len(accepted):
            self._apply_kalman_update(innovation[accepted].ravel(), H, variance)

    def _apply_kalman_update(self, innovation: Array, H: Array, variance: float) -> None:
        """Apply Kalman's measurement update in Joseph's form.

        Args:
            innovation: (M,) equal to H xi + noise.
            H: (M, E) measurement Jacobian.
            variance: of each independent measurement.
        """
        PH = self.P @ H.T
        innovation_covariance = H @ PH + variance * np.eye(len(H))
        gain: Array = np.linalg.solve(innovation_covariance, PH.T).T.astype(float)
        complement = np.eye(self.error_size) - gain @ H
        self.P = complement @ self.P @ complement.T + variance * gain @ gain.T
        self.P = 0.5 * (self.P + self.P.T)
        self._apply_correction(-gain @ innovation)

    def _apply_correction(self, xi: Array) -> None:
        """Correct the state: X^ becomes exp(xi) X^, and xi is added to the biases."""
        rotation, jacobian = exponential(xi[ORIENTATION]), left_jacobian(xi[ORIENTATION])
        self.R = rotation @ self.R
        self.v = rotation @ self.v + jacobian @ xi[VELOCITY]
        self.p = rotation @ self.p + jacobian @ xi[POSITION]
        for leg in _indices(self.standing):
            self.d[leg] = rotation @ self.d[leg] + jacobian @ xi[foot_slice(leg)]
        self.gyro_bias = self.gyro_bias + xi[GYRO_BIAS]
        self.accel_bias = self.accel_bias + xi[ACCEL_BIAS]

    def _initialise_foot(self, leg: int, toe: Array) -> None:
        """Add a foot at touchdown, where the encoders place it: xi_d = xi_p + R^ n."""
        self.d[leg] = self.p + self.R @ toe
        foot_rows = foot_slice(leg)
        self.P[foot_rows, :] = self.P[POSITION, :]
        self.P[:, foot_rows] = self.P[:, POSITION]
        self.P[foot_rows, foot_rows] = self.P[POSITION, POSITION] + self.quality.toe**2 * np.eye(3)
        self.standing[leg] = True

    def _reset_foot(self, leg: int) -> None:
        """Drop a foot from the state: no correlation, and a large variance."""
        foot_rows = foot_slice(leg)
        self.P[foot_rows, :], self.P[:, foot_rows] = 0.0, 0.0
        self.P[foot_rows, foot_rows] = _AIRBORNE_VARIANCE * np.eye(3)
        self.standing[leg] = False

    def _set_variance(self, block: slice, deviation: float) -> None:
        """Set one block of the covariance to a multiple of the identity."""
        self.P[block, block] = deviation**2 * np.eye(3)


def skew(vector: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with a vector (3,)."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(rotation_vector: Array) -> Array:
    """Return the rotation (3, 3) by a rotation vector (3,), by Rodrigues' formula."""
    angle = float(np.linalg.norm(rotation_vector))
    K = skew(rotation_vector)
    if angle < _SMALL_ANGLE:
        first_order: Array = np.eye(3) + K
        return first_order
    result: Array = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)
    return result


def logarithm(R: Array) -> Array:
    """Return the rotation vector (3,) of a rotation (3, 3) by less than half a turn."""
    twice = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = 0.5 * float(np.linalg.norm(twice)), 0.5 * (float(np.trace(R)) - 1)
    angle = float(np.arctan2(sine, cosine))
    vector: Array = 0.5 * twice if sine < _SMALL_ANGLE else angle / (2 * sine) * twice
    return vector


def left_jacobian(rotation_vector: Array) -> Array:
    """Return the left Jacobian (3, 3) of SO(3): exp(r + small) = exp(J small) exp(r)."""
    angle = float(np.linalg.norm(rotation_vector))
    K = skew(rotation_vector)
    if angle < 1e-4:
        first_order: Array = np.eye(3) + 0.5 * K
        return first_order
    result: Array = (
        np.eye(3)
        + (1 - np.cos(angle)) / angle**2 * K
        + (angle - np.sin(angle)) / angle**3 * (K @ K)
    )
    return result
