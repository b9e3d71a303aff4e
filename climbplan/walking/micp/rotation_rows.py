"""Rows of rotation: rates of the Euler angles and gyroscopic moments, by envelopes of products.

In a wide attitude box neither is nearly linear about the middle. Both are stated as products of
variables: of angular velocities with sines of angles, and of two angular velocities about the
principal axes. What a function or a rotation is off its linearisation is a bounded remainder.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.state_variables import MIN_ENVELOPE_ERROR, MIN_RANGE, StateVariables

TrigFunction = Literal["secant", "tangent"]
_GRID = 201  # points of a range
_ROUNDING = 1e-12
_MIN_HALF = 1e-9  # [rad] narrower ranges of an angle are values


@dataclass(frozen=True)
class LinearFit:
    """A line that is a function up to an error: middle + slope (x - x_middle) +- max_error."""

    middle: float
    slope: float
    max_error: float


def fit_sine(half: float) -> tuple[float, float]:
    """Fit a line through zero to sin x for |x| <= half <= pi / 2.

    Returns:
        Its slope, and its largest error.
    """
    if half < _MIN_HALF:
        return 1.0, half
    slope = max(
        1.0 - half**2 / 8.0, 0.0
    )  # to fourth order the error is equal inside and at the ends
    # sin x - slope x rises up to where the cosine is the slope, and falls from there.
    top = min(float(np.arccos(slope)), half)
    return slope, max(abs(float(np.sin(x)) - slope * x) for x in (top, half)) + _ROUNDING


def fit_line(name: TrigFunction, middle: float, half: float) -> LinearFit:
    """Fit a line to a function on [middle - half, middle + half], where |middle| + half < pi / 2.

    The line is parallel to the one through both ends, and its error is equal to both sides.
    """
    x = np.linspace(middle - half, middle + half, _GRID)
    values = 1.0 / np.cos(x) if name == "secant" else np.tan(x)
    if half < _MIN_HALF:
        return LinearFit(float(values[0]), 0.0, float(np.ptp(values)) + _ROUNDING)
    steepest = abs(middle) + half
    sec, tan = 1.0 / np.cos(steepest), np.tan(steepest)
    curvature = sec * (tan**2 + sec**2) if name == "secant" else 2.0 * sec**2 * tan
    slope = (values[-1] - values[0]) / (2.0 * half)
    residual = values - slope * (x - middle)
    # The second term is the error of interpolation between points of the grid.
    error = 0.5 * np.ptp(residual) + (x[1] - x[0]) ** 2 * curvature / 8.0
    center = 0.5 * (residual.min() + residual.max())
    return LinearFit(float(center), float(slope), float(error) + _ROUNDING)


_ALWAYS = LinExpr(constant=1.0)  # the indicator of products that no binary switches off
_NEXT_AXIS, _LAST_AXIS = (1, 2, 0), (2, 0, 1)  # of a cross product


class RotationRows(StateVariables):
    """Rows of the rotation of the body at each knot."""

    def build_small_rotation(self, n: int) -> list[LinExpr]:
        """Return the rotation vector (3,) from the middle of the box, about the body axes there.

        It is linear in the angles, and correct to first order.
        """
        middle, jacobian = self.attitude_box.angles[n], self.rotations[n].turn_jacobian
        change = [self.angles[n][j] - float(middle[j]) for j in range(3)]
        return [
            sum_expressions(change[j] * float(jacobian[i, j]) for j in range(3)) for i in range(3)
        ]

    def build_principal_rotation(self, n: int) -> tuple[list[LinExpr], Array]:
        """Return that rotation vector (3,) about the principal axes, and its largest size (3,)."""
        rotation = self.rotations[n]
        axes, vector = rotation.principal_axes, self.build_small_rotation(n)
        principal = [
            sum_expressions(vector[j] * float(axes[j, k]) for j in range(3)) for k in range(3)
        ]
        max_angle = np.abs(axes.T @ rotation.turn_jacobian) @ self.attitude_box.angles_half[n]
        return principal, max_angle

    def rotate_to_body(
        self, name: str, n: int, vector: list[LinExpr], low: Array, high: Array
    ) -> list[LinExpr]:
        """Rotate a vector from the middle attitude to that of the body, to first order.

        Args:
            name: Name of the block of envelopes.
            n: The knot.
            vector: R_middle^T r (3,) of a vector r in the world frame.
            low: Lower bounds of that (3,).
            high: Upper bounds of that (3,).

        Returns:
            R_middle^T r - w x (R_middle^T r) with the small rotation w: R^T r to first order.
        """
        max_turn, turn = self.rotations[n].max_turn, self.build_small_rotation(n)
        rotated = []
        for k in range(3):
            i, j = _NEXT_AXIS[k], _LAST_AXIS[k]
            first = self.add_envelope(name, turn[i], max_turn[i], vector[j], low[j], high[j])
            second = self.add_envelope(name, turn[j], max_turn[j], vector[i], low[i], high[i])
            rotated.append(vector[k] - first + second)
        return rotated

    def add_envelope(
        self, name: str, x: LinExpr, half: float, y: LinExpr, low: float, high: float
    ) -> LinExpr:
        """Return x y with |x| <= half and y in [low, high], by its McCormick envelope."""
        if half < _MIN_HALF:
            return LinExpr()
        if high - low < 1e-12:
            return x * low
        if (error := 0.5 * half * (high - low)) <= MIN_ENVELOPE_ERROR:
            return x * (0.5 * (low + high)) + self.add_remainder(error)
        w = self.add_free_variable(half * max(abs(low), abs(high)))
        for side in (1.0, -1.0):
            self.model.add_nonnegative(name, (w - x * low) * side + (y - low) * half)
            self.model.add_nonnegative(name, (x * high - w) * side + (high - y) * half)
        return w

    def add_attitude_rows(self, n: int) -> None:
        """Add rows of the angles at the next knot, eq. (8.17).

        With a = w_x cos yaw + w_y sin yaw and c = w_y cos yaw - w_x sin yaw, the rate of roll is
        a / cos pitch, that of pitch is c, and that of yaw is w_z + a tan pitch.
        """
        name, dt, attitude_box = "dynamics.attitude", self.task.dt, self.attitude_box
        pitch, pitch_half = attitude_box.angles[n, 1], attitude_box.angles_half[n, 1]
        a, c = self.add_levelled_omega(n)
        low, high = self.compute_interval(a)
        pitch_change = self.angles[n][1] - float(pitch)
        product = self.add_envelope(name, pitch_change, pitch_half, a, low, high)
        max_a = max(abs(low), abs(high))
        secant = fit_line("secant", float(pitch), float(pitch_half))
        tangent = fit_line("tangent", float(pitch), float(pitch_half))
        yaw_rate = self.omega[n][2] + a * tangent.middle + product * tangent.slope
        rates = (
            (a * secant.middle + product * secant.slope, secant.max_error * max_a),
            (c, 0.0),
            (yaw_rate, tangent.max_error * max_a),
        )
        for k, (rate, error) in enumerate(rates):
            residual = self.angles[n + 1][k] - self.angles[n][k] - rate * dt
            self.model.add_constraint(name, residual, -dt * error, dt * error)

    def add_levelled_omega(self, n: int) -> tuple[LinExpr, LinExpr]:
        """Add the horizontal angular velocity about axes that are rotated by the yaw of the body.

        Returns:
            w_x cos yaw + w_y sin yaw, and w_y cos yaw - w_x sin yaw.
        """
        model, name = self.model, "dynamics.attitude"
        yaw, yaw_half = self.attitude_box.angles[n, 2], self.attitude_box.angles_half[n, 2]
        cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
        w = self.omega[n]
        middle = (w[0] * cos + w[1] * sin, w[1] * cos - w[0] * sin)  # at the yaw of the middle
        yaw_change = self.angles[n][2] - float(yaw)
        slope, sine_error = fit_sine(float(yaw_half))
        mean_cosine, cosine_error = 0.5 + 0.5 * np.cos(yaw_half), 0.5 - 0.5 * np.cos(yaw_half)
        ends = [self.compute_interval(u) for u in middle]
        size = [max(map(abs, end)) for end in ends]
        norm = float(np.hypot(size[0], size[1])) + MIN_RANGE  # which a rotation keeps
        levelled = []
        for k, sign in ((0, 1.0), (1, -1.0)):
            product = self.add_envelope(
                name, yaw_change, float(yaw_half), middle[1 - k], *ends[1 - k]
            )
            error = float(cosine_error * size[k] + sine_error * size[1 - k])
            expression = middle[k] * float(mean_cosine) + product * (sign * slope)
            low, high = self.compute_interval(middle[k] * float(mean_cosine))
            margin = error + slope * float(yaw_half) * size[1 - k] + MIN_RANGE
            component = model.add_variable(max(low - margin, -norm), min(high + margin, norm))
            model.add_constraint(name, component - expression, -error, error)
            levelled.append(component)
        return levelled[0], levelled[1]

    def add_gyroscopic_moment(self, n: int) -> tuple[list[LinExpr], Array]:
        """Add the gyroscopic moment -w x I w about the principal axes, a product for each axis.

        Returns:
            The moment (3,), and its largest size (3,).
        """
        model, rotation, name = self.model, self.rotations[n], "dynamics.angular_velocity"
        w = self.omega[n]
        middle = [
            sum_expressions(w[j] * float(rotation.R[j, k]) for j in range(3)) for k in range(3)
        ]
        ends = np.array([self.compute_interval(component) for component in middle])
        in_body = self.rotate_to_body(name, n, middle, ends[:, 0], ends[:, 1])
        axes, principal_omega = rotation.principal_axes, []
        ranges = [
            (float(low), float(high))
            for low, high in zip(
                rotation.principal_omega_low, rotation.principal_omega_high, strict=True
            )
        ]
        for k in range(3):
            remainder = np.stack(
                [
                    axes[:, k] * rotation.omega_remainder_low,
                    axes[:, k] * rotation.omega_remainder_high,
                ]
            )
            omega = model.add_variable(*ranges[k])
            linear = sum_expressions(in_body[j] * float(axes[j, k]) for j in range(3))
            low, high = remainder.min(axis=0).sum(), remainder.max(axis=0).sum()
            model.add_constraint(name, omega - linear, low, high)
            principal_omega.append(omega)
        moments, max_moments = [], np.zeros(3)
        inertia = rotation.principal_moments
        for k in range(3):
            i, j = _NEXT_AXIS[k], _LAST_AXIS[k]
            product = self.add_switched_product(
                principal_omega[i], ranges[i], principal_omega[j], ranges[j], _ALWAYS
            )
            moments.append(product * float(inertia[i] - inertia[j]))
            max_product = max(abs(a * b) for a in ranges[i] for b in ranges[j])
            max_moments[k] = abs(inertia[i] - inertia[j]) * max_product
        return moments, max_moments
