"""Contact-aided extended Kalman filter on an inertial unit, encoders and contacts.

Standing toes do not move in the world, so that their places seen from the body tell how it moves.
The error is the right-invariant one, exp(xi) = X_hat X^-1 of the pose X = (rotation, velocity,
position, toes): its dynamics do not depend on the estimate, and yaw and position, which nothing
measures, stay unobservable in the linearisation as they are in truth (Hartley, Jadidi, Grizzle and
Eustice, 2018, after Bloesch et al., 2012). World frame with z up; body frame of chapter 8.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from climbplan.mpc.estimation.lie import (
    cross_matrix,
    euler,
    exponential,
    left_jacobian,
    logarithm,
)
from climbplan.mpc.estimation.sensors import Readings, SensorNoise
from climbplan.mpc.task import ANGLES, LEGS, POSITION, VELOCITY, Array, Flags
from climbplan.robots.rotations import rotation_world_body

CORE = 9  # rotation, velocity, position: rows of the error that all walks share
SIZE = CORE + 3 * LEGS + 6  # and toes, gyro bias, accelerometer bias
ROTATION, SPEED, PLACE = slice(0, 3), slice(3, 6), slice(6, 9)
TOES = slice(CORE, SIZE - 6)
GYRO, ACCELEROMETER = slice(SIZE - 6, SIZE - 3), slice(SIZE - 3, SIZE)
_GATE = float(chi2.ppf(0.9999, 3))  # a standing toe further off than this has slipped


def toe_rows(leg: int) -> slice:
    """Rows of a toe in the error and its covariance."""
    return slice(CORE + 3 * leg, CORE + 3 * leg + 3)


@dataclass(frozen=True)
class Prior:
    """Standard deviations of what is known at the start."""

    rotation: float = 0.02  # [rad] about each world axis
    velocity: float = 0.05  # [m/s]
    position: float = 0.01  # [m]

    def draw(self, state: Array, rng: np.random.Generator) -> Array:
        """A state (12,) that is off the true one by a draw of such errors."""
        xi = rng.normal(size=CORE) * self.deviations
        turn, J = exponential(xi[ROTATION]), left_jacobian(xi[ROTATION])
        drawn = state.copy()
        drawn[ANGLES] = euler(turn @ rotation_world_body(state[ANGLES]))
        drawn[VELOCITY] = turn @ state[VELOCITY] + J @ xi[SPEED]
        drawn[POSITION] = turn @ state[POSITION] + J @ xi[PLACE]
        return drawn

    @property
    def deviations(self) -> Array:
        """(9,)"""
        return np.repeat([self.rotation, self.velocity, self.position], 3)


class ContactFilter:
    """Estimate of the body's state, its standing toes and the sensors' biases."""

    def __init__(
        self,
        state: Array,
        noise: SensorNoise,
        prior: Prior | None = None,
        gravity: float = 9.81,
        ground: float | None = 0.0,
    ) -> None:
        """Start from a state (12,) known as well as the prior says.

        ground: height [m] that standing toes are known to stand at; None where it is not known,
        and height drifts as x and y do.
        """
        self.noise, self._gravity, self._ground = noise, np.array([0.0, 0.0, -gravity]), ground
        self.rotation = rotation_world_body(state[ANGLES])  # (3, 3)
        self.velocity, self.position = state[VELOCITY].copy(), state[POSITION].copy()
        self.toes = np.zeros((LEGS, 3))  # [m] world frame; of swinging legs where last seen
        self.standing: Flags = np.zeros(LEGS, bool)
        self.gyro_bias, self.accelerometer_bias = np.zeros(3), np.zeros(3)
        self.spin = state[9:12].copy()  # [rad/s] world frame
        self.covariance = np.zeros((SIZE, SIZE))
        deviations = (prior or Prior()).deviations
        self.covariance[:CORE, :CORE] = np.diag(deviations**2)
        self.covariance[GYRO, GYRO] = noise.gyro_bias**2 * np.eye(3)
        self.covariance[ACCELEROMETER, ACCELEROMETER] = noise.accelerometer_bias**2 * np.eye(3)
        self.slipped = 0  # toes taken anew because they were not where they stood

    @property
    def state(self) -> Array:
        """Position, velocity, roll, pitch, yaw, angular velocity (12,), world frame."""
        return np.concatenate([self.position, self.velocity, euler(self.rotation), self.spin])

    def step(self, readings: Readings, dt: float) -> None:
        """Move on by dt [s] to the time of these readings.

        Raises:
            ValueError: they are no measurements; the estimate is what it was before.
        """
        if faults := readings.faults():
            raise ValueError("; ".join(faults))
        self._predict(readings, dt)
        self._correct(readings)

    def _predict(self, readings: Readings, dt: float) -> None:
        """Mean and covariance after an interval of constant rate and specific force."""
        rate = readings.gyro - self.gyro_bias
        R, turn = self.rotation, dt * rate
        middle = R @ exponential(0.5 * turn)
        acceleration = middle @ (readings.accelerometer - self.accelerometer_bias) + self._gravity
        A, G = np.zeros((SIZE, SIZE)), np.zeros((SIZE, 6))
        A[SPEED, ROTATION] = cross_matrix(self._gravity)
        A[PLACE, SPEED] = np.eye(3)
        G[ROTATION, :3] = R
        G[SPEED, :3], G[SPEED, 3:] = cross_matrix(self.velocity) @ R, R
        G[PLACE, :3] = cross_matrix(self.position) @ R
        for leg in np.flatnonzero(self.standing).tolist():
            G[toe_rows(leg), :3] = cross_matrix(self.toes[leg]) @ R
        A[:, GYRO], A[:, ACCELEROMETER] = -G[:, :3], -G[:, 3:]
        step = dt * A
        square = step @ step
        Phi = np.eye(SIZE) + step + square / 2 + square @ step / 6
        noise = self.noise
        spread = dt * np.repeat([noise.gyro, noise.accelerometer], 3) * G
        P = Phi @ self.covariance @ Phi.T + spread @ spread.T
        walk = np.zeros(SIZE)
        walk[GYRO], walk[ACCELEROMETER] = noise.gyro_bias**2, noise.accelerometer_bias**2
        walk[TOES] = noise.slip**2 * np.repeat(self.standing, 3)
        P[np.diag_indices(SIZE)] += dt * walk
        self.covariance = 0.5 * (P + P.T)
        self.position = self.position + dt * self.velocity + 0.5 * dt**2 * acceleration
        self.velocity = self.velocity + dt * acceleration
        self.rotation = R @ exponential(turn)
        self.spin = self.rotation @ rate

    def _correct(self, readings: Readings) -> None:
        """Standing toes hold the body; those that came down are taken into the state."""
        held = self._hold(readings)
        came_down = readings.contact & ~held
        self.standing = readings.contact.copy()
        for leg in np.flatnonzero(came_down).tolist():
            self._place(leg, readings.toes[leg])
        if self._ground is not None:
            for leg in np.flatnonzero(
                came_down
            ).tolist():  # once: how uneven it is there stays the same
                self._level(leg, self._ground)
        swinging = ~readings.contact
        self.toes[swinging] = (self.position + readings.toes @ self.rotation.T)[swinging]

    def _hold(self, readings: Readings) -> Flags:
        """Correct by toes that stand where they stood; returns which did (4,)."""
        offset = self.position + readings.toes @ self.rotation.T - self.toes  # (4, 3)
        held = readings.contact & self.standing
        P, variance = self.covariance, self.noise.encoder**2
        rows = (P[PLACE] - P[CORE : CORE + 3 * LEGS].reshape(LEGS, 3, SIZE)).reshape(
            -1, SIZE
        )  # H P
        toes = rows[:, CORE : CORE + 3 * LEGS].reshape(3 * LEGS, LEGS, 3)
        S = (rows[:, None, PLACE] - toes).reshape(3 * LEGS, 3 * LEGS) + variance * np.eye(3 * LEGS)
        for leg in np.flatnonzero(held).tolist():
            own = slice(3 * leg, 3 * leg + 3)
            if offset[leg] @ np.linalg.solve(S[own, own], offset[leg]) > _GATE:
                held[leg] = False
                self.slipped += 1
        if held.any():
            kept = np.flatnonzero(np.repeat(held, 3))
            self._update(rows[kept], S[np.ix_(kept, kept)], offset.ravel()[kept])
        return held

    def _level(self, leg: int, ground: float) -> None:
        """Correct by the height of the ground that a toe came down on."""
        H = np.zeros(SIZE)
        x, y, height = self.toes[leg]
        H[:2], H[toe_rows(leg).stop - 1] = (y, -x), 1.0
        rows = H[None] @ self.covariance
        S = rows @ H[:, None] + self.noise.ground**2
        self._update(rows, S, np.array([height - ground]))

    def _update(self, rows: Array, S: Array, offset: Array) -> None:
        """Correct by measurements (m,) off by `offset`; rows: H P (m, SIZE), S their covariance."""
        K = np.linalg.solve(S, rows).T
        xi = -K @ offset
        P = self.covariance - K @ rows
        self.covariance = 0.5 * (P + P.T)
        turn, J = exponential(xi[ROTATION]), left_jacobian(xi[ROTATION])
        self.rotation = turn @ self.rotation
        self.velocity = turn @ self.velocity + J @ xi[SPEED]
        self.position = turn @ self.position + J @ xi[PLACE]
        shifts = xi[TOES].reshape(LEGS, 3)
        moved = self.toes @ turn.T + shifts @ J.T
        self.toes = np.where(self.standing[:, None], moved, self.toes)
        self.gyro_bias = self.gyro_bias + xi[GYRO]
        self.accelerometer_bias = self.accelerometer_bias + xi[ACCELEROMETER]

    def _place(self, leg: int, seen: Array) -> None:
        """Take a toe that came down into the state: it is where it is seen from the body."""
        self.toes[leg] = self.position + self.rotation @ seen
        P, rows = self.covariance, toe_rows(leg)
        P[rows, :] = P[PLACE, :]
        P[:, rows] = P[:, PLACE]
        P[rows, rows] = P[PLACE, PLACE] + self.noise.encoder**2 * np.eye(3)

    def error(self, state: Array) -> Array:
        """Right-invariant error (9,) of rotation, velocity, position against a truth (12,)."""
        off = self.rotation @ rotation_world_body(state[ANGLES]).T
        phi = logarithm(off)
        back = np.linalg.inv(left_jacobian(phi))
        speed = back @ (self.velocity - off @ state[VELOCITY])
        place = back @ (self.position - off @ state[POSITION])
        return np.concatenate([phi, speed, place])

    def nees(self, state: Array) -> float:
        """Normalised estimation error squared; chi-square of 9 degrees if it is consistent."""
        error = self.error(state)
        return float(error @ np.linalg.solve(self.covariance[:CORE, :CORE], error))
