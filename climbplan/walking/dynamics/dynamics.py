"""Single rigid-body dynamics as CasADi expressions, eqs. (8.14) to (8.21).

With position p, velocity v, Euler angles e and angular velocity w of a body with contact forces
f_i at toes x_i:

    m v' = sum f_i - m g,   R I R' w' + w x (R I R' w) = sum (x_i - p) x f_i,   e' = E(e) w.

Compiled steps are generated from them (`kernels/dynamics_step.py`).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from climbplan.robots.symbols import build_rotation
from climbplan.walking.task.task import RigidBody


def euler_rates(angles: Any, spin: Any) -> Any:
    """Return the rates of roll, pitch, yaw, eq. (8.17) solved for them."""
    along = ca.cos(angles[2]) * spin[0] + ca.sin(angles[2]) * spin[1]
    roll = along / ca.cos(angles[1])
    pitch = ca.cos(angles[2]) * spin[1] - ca.sin(angles[2]) * spin[0]
    return ca.vertcat(roll, pitch, spin[2] + ca.sin(angles[1]) * roll)


def sum_contact_wrench(toes: Any, force: Any) -> tuple[Any, Any]:
    """Return the sum of forces and of moments about the world's origin; toes, force: (3 L,)."""
    legs = [slice(3 * i, 3 * i + 3) for i in range(force.shape[0] // 3)]
    push = sum((force[leg] for leg in legs), ca.SX.zeros(3))
    about_origin = sum((ca.cross(toes[leg], force[leg]) for leg in legs), ca.SX.zeros(3))
    return push, about_origin


def state_derivative(body: Body, state: Any, push: Any, about_origin: Any) -> Any:
    """Return the time derivative (12,) of the state, eqs. (8.14) to (8.17), under a contact wrench.

    Args:
        body: mass properties.
        state: (12,).
        push: (3,) sum of contact forces.
        about_origin: (3,) sum of their moments about the world's origin.
    """
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)
    alpha = _angular_acceleration(body, angles, spin, about_origin - ca.cross(position, push))
    return ca.vertcat(velocity, a, euler_rates(angles, spin), alpha)


def knot_step(body: Body, dt: Any, mean: Any, state: Any, push: Any, about_origin: Any) -> Any:
    """Return the state one knot later, eq. (8.19), under a contact wrench.

    Args:
        body: mass properties.
        dt: length of the interval.
        mean: 0 for forward Euler; 1 for Runge-Kutta over the interval, with the body moving over
            fixed toes.
        state: (12,).
        push: (3,) sum of contact forces.
        about_origin: (3,) sum of their moments about the world's origin.
    """
    if isinstance(mean, int | float) and mean == 0:  # four stages would all be the same
        return state + dt * state_derivative(body, state, push, about_origin)
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)

    def rates(attitude: Any, rate: Any, arm: Any) -> Any:
        moment = about_origin - ca.cross(arm, push)
        alpha = _angular_acceleration(body, attitude, rate, moment)
        return ca.vertcat(euler_rates(attitude, rate), alpha)

    def stage(after: float, slope: Any) -> Any:
        ahead = mean * dt * after
        rotation_state = ca.vertcat(angles, spin) + ahead * slope
        return rates(
            rotation_state[:3], rotation_state[3:], position + ahead * (velocity + 0.5 * ahead * a)
        )

    k1 = rates(angles, spin, position)
    k2 = stage(0.5, k1)
    k3 = stage(0.5, k2)
    k4 = stage(1.0, k3)
    next_rotation = ca.vertcat(angles, spin) + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    next_position = position + dt * (velocity + mean * 0.5 * dt * a)
    return ca.vertcat(next_position, velocity + dt * a, next_rotation)


def single_stage_knot_step(
    body: Body, dt: Any, mean: Any, state: Any, push: Any, about_origin: Any
) -> Any:
    """Return the step like `knot_step`, for `mean` 1 with one stage under the mean moment.

    It serves second derivatives, which have a tenth of the operations of the four-stage step.
    """
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)
    arm = position + mean * dt * (velocity / 2 + dt * a / 6)
    moment = about_origin - ca.cross(arm, push)
    alpha = _angular_acceleration(body, angles, spin, moment)
    next_angles = angles + dt * euler_rates(angles, spin + mean * 0.5 * dt * alpha)
    next_position = position + dt * (velocity + mean * 0.5 * dt * a)
    return ca.vertcat(next_position, velocity + dt * a, next_angles, spin + dt * alpha)


def _acceleration(body: Body, push: Any) -> Any:
    """Return the linear acceleration, eq. (8.14)."""
    return push / body.mass - ca.vertcat(0, 0, body.gravity)


def _angular_acceleration(body: Body, angles: Any, spin: Any, moment: Any) -> Any:
    """Return the angular acceleration under a moment, eq. (8.15), world frame."""
    inertia, inverse = body.tensors
    R = build_rotation(angles)
    body_rate = R.T @ spin  # in the body frame, where the inertia is constant
    return R @ (inverse @ (R.T @ moment - ca.cross(body_rate, inertia @ body_rate)))


class Body(Protocol):
    """The mass properties of a body, as numbers or as symbols."""

    @property
    def mass(self) -> Any:
        """Mass [kg]."""

    @property
    def gravity(self) -> Any:
        """Downward acceleration [m/s^2]."""

    @property
    def tensors(self) -> tuple[Any, Any]:
        """Inertia (3, 3) about the centre of mass, body frame [kg m^2], and its inverse."""


@dataclass(frozen=True)
class BodyNumbers:
    """The mass properties as numbers; hashable, so compiled functions are shared."""

    mass: float
    gravity: float
    inertia: tuple[float, ...]  # (9,) row by row

    @classmethod
    def of(cls, body: RigidBody) -> BodyNumbers:
        """Return the mass properties of a rigid body."""
        return cls(body.mass, body.gravity, tuple(float(v) for v in body.inertia.ravel()))

    @property
    def tensors(self) -> tuple[Any, Any]:
        """Inertia (3, 3) and its inverse."""
        inertia = np.reshape(self.inertia, (3, 3))
        return ca.DM(inertia), ca.DM(np.linalg.inv(inertia))


@dataclass(frozen=True, eq=False)
class BodySymbols:
    """The mass properties as symbols, inputs of an expression."""

    mass: Any
    gravity: Any
    tensors: tuple[Any, Any]
