"""The rigid-body dynamics as CasADi expressions: what solvers differentiate (eqs. 8.14 to 8.21).

Compiled steps are generated from them (`kernels/step.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from climbplan.robots.symbols import rotation
from climbplan.walking.task.task import RigidBody


def euler_rates(angles: Any, spin: Any) -> Any:
    """Rates of roll, pitch, yaw, eq. (8.17) solved for them."""
    along = ca.cos(angles[2]) * spin[0] + ca.sin(angles[2]) * spin[1]
    roll = along / ca.cos(angles[1])
    pitch = ca.cos(angles[2]) * spin[1] - ca.sin(angles[2]) * spin[0]
    return ca.vertcat(roll, pitch, spin[2] + ca.sin(angles[1]) * roll)


def net_load(toes: Any, force: Any) -> tuple[Any, Any]:
    """Sum of forces, and of their moments about the world's origin; toes, force: (3 L,)."""
    legs = [slice(3 * i, 3 * i + 3) for i in range(force.shape[0] // 3)]
    push = sum((force[leg] for leg in legs), ca.SX.zeros(3))
    about_origin = sum((ca.cross(toes[leg], force[leg]) for leg in legs), ca.SX.zeros(3))
    return push, about_origin


def derivative(body: Body, state: Any, push: Any, about_origin: Any) -> Any:
    """Time derivative (12,) of the state, eqs. (8.14) to (8.17), under a load as of `net_load`."""
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)
    alpha = _spin_acceleration(body, angles, spin, about_origin - ca.cross(position, push))
    return ca.vertcat(velocity, a, euler_rates(angles, spin), alpha)


def knot_step(body: Body, dt: Any, mean: Any, state: Any, push: Any, about_origin: Any) -> Any:
    """The state one knot later, eq. (8.19), under a load as of `net_load`.

    mean: 0 for forward Euler; 1 for Runge-Kutta over the interval, in which the body moves on above
    the toes (`truth.knot_step` says how).
    """
    if isinstance(mean, int | float) and mean == 0:  # four stages would all be the same
        return state + dt * derivative(body, state, push, about_origin)
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)

    def rates(turned: Any, turning: Any, arm: Any) -> Any:
        moment = about_origin - ca.cross(arm, push)
        alpha = _spin_acceleration(body, turned, turning, moment)
        return ca.vertcat(euler_rates(turned, turning), alpha)

    def stage(after: float, slope: Any) -> Any:
        ahead = mean * dt * after
        moved = ca.vertcat(angles, spin) + ahead * slope
        return rates(moved[:3], moved[3:], position + ahead * (velocity + 0.5 * ahead * a))

    k1 = rates(angles, spin, position)
    k2 = stage(0.5, k1)
    k3 = stage(0.5, k2)
    k4 = stage(1.0, k3)
    turn = ca.vertcat(angles, spin) + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    there = position + dt * (velocity + mean * 0.5 * dt * a)
    return ca.vertcat(there, velocity + dt * a, turn)


def plain_knot_step(
    body: Body, dt: Any, mean: Any, state: Any, push: Any, about_origin: Any
) -> Any:
    """As `knot_step` for `mean` 0; for 1 with one stage under the mean moment of the interval.

    Where only second derivatives count: those of four stages have ten times as many operations.
    """
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    a = _acceleration(body, push)
    arm = position + mean * dt * (velocity / 2 + dt * a / 6)
    moment = about_origin - ca.cross(arm, push)
    alpha = _spin_acceleration(body, angles, spin, moment)
    turn = angles + dt * euler_rates(angles, spin + mean * 0.5 * dt * alpha)
    there = position + dt * (velocity + mean * 0.5 * dt * a)
    return ca.vertcat(there, velocity + dt * a, turn, spin + dt * alpha)


def _acceleration(body: Body, push: Any) -> Any:
    """Eq. (8.14)."""
    return push / body.mass - ca.vertcat(0, 0, body.gravity)


def _spin_acceleration(body: Body, angles: Any, spin: Any, moment: Any) -> Any:
    """Angular acceleration under a moment, eq. (8.15), world frame."""
    inertia, inverse = body.tensors
    R = rotation(angles)
    seen = R.T @ spin  # in the body frame, where the inertia is constant
    return R @ (inverse @ (R.T @ moment - ca.cross(seen, inertia @ seen)))


class Body(Protocol):
    """What the dynamics need of a body, as numbers or as symbols."""

    @property
    def mass(self) -> Any:
        """[kg]."""

    @property
    def gravity(self) -> Any:
        """Downward [m/s^2]."""

    @property
    def tensors(self) -> tuple[Any, Any]:
        """Inertia about the centre of mass (3, 3), body frame [kg m^2], and its inverse."""


@dataclass(frozen=True)
class BodyNumbers:
    """What the dynamics need of a body; hashable, so that compiled functions are shared."""

    mass: float
    gravity: float
    inertia: tuple[float, ...]  # (9,) row by row

    @classmethod
    def of(cls, body: RigidBody) -> BodyNumbers:
        return cls(body.mass, body.gravity, tuple(float(v) for v in body.inertia.ravel()))

    @property
    def tensors(self) -> tuple[Any, Any]:
        """As of `Body`."""
        inertia = np.reshape(self.inertia, (3, 3))
        return ca.DM(inertia), ca.DM(np.linalg.inv(inertia))


@dataclass(frozen=True, eq=False)
class BodySymbols:
    """The same as what is given when an expression is evaluated."""

    mass: Any
    gravity: Any
    tensors: tuple[Any, Any]
