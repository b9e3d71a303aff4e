"""The rigid-body dynamics as CasADi expressions: what solvers differentiate (eqs. 8.14 to 8.21)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.mpc.task import LEGS, STATE, Array, RigidBody


def rotation(angles: Any) -> Any:
    """Body-to-world rotation, eq. (8.16)."""
    (sr, sp, sy), (cr, cp, cy) = (ca.vertsplit(f(angles)) for f in (ca.sin, ca.cos))
    return ca.vertcat(
        ca.horzcat(cp * cy, sr * sp * cy - sy * cr, sr * sy + sp * cr * cy),
        ca.horzcat(sy * cp, cr * cy + sr * sp * sy, sp * sy * cr - sr * cy),
        ca.horzcat(-sp, sr * cp, cr * cp),
    )


def euler_rates(angles: Any, spin: Any) -> Any:
    """Rates of roll, pitch, yaw, eq. (8.17) solved for them."""
    along = ca.cos(angles[2]) * spin[0] + ca.sin(angles[2]) * spin[1]
    roll = along / ca.cos(angles[1])
    pitch = ca.cos(angles[2]) * spin[1] - ca.sin(angles[2]) * spin[0]
    return ca.vertcat(roll, pitch, spin[2] + ca.sin(angles[1]) * roll)


def knot_step(body: BodyNumbers, dt: Any, mean: Any, state: Any, toes: Any, force: Any) -> Any:
    """The state one knot later, eq. (8.19).

    mean: 0 for forward Euler; 1 for Runge-Kutta over the interval, in which the body moves on above
    the toes (`truth.knot_step` says how). toes, force: (12,) leg by leg.
    """
    position, velocity, angles, spin = ca.vertsplit(state, 3)
    legs = [slice(3 * i, 3 * i + 3) for i in range(LEGS)]
    # Newton, eq. (8.14)
    push = sum((force[leg] for leg in legs), ca.SX.zeros(3))
    a = push / body.mass - ca.vertcat(0, 0, body.gravity)
    # Euler, eq. (8.15), in the world frame
    inertia = ca.DM(np.reshape(body.inertia, (3, 3)))
    inverse = ca.DM(np.linalg.inv(np.reshape(body.inertia, (3, 3))))
    about_origin = sum((ca.cross(toes[leg], force[leg]) for leg in legs), ca.SX.zeros(3))

    def rates(turned: Any, turning: Any, arm: Any) -> Any:
        R = rotation(turned)
        seen = R.T @ turning  # angular velocity in the body frame, where the inertia is constant
        moment = about_origin - ca.cross(arm, push)
        alpha = R @ (inverse @ (R.T @ moment - ca.cross(seen, inertia @ seen)))
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


@dataclass(frozen=True)
class BodyNumbers:
    """What the dynamics need of a body; hashable, so that compiled functions are shared."""

    mass: float
    gravity: float
    inertia: tuple[float, ...]  # (9,) row by row

    @classmethod
    def of(cls, body: RigidBody) -> BodyNumbers:
        return cls(body.mass, body.gravity, tuple(float(v) for v in body.inertia.ravel()))


class KnotModel:
    """Next states and toe positions with their Jacobians at N knots in one call each.

    Inputs and outputs are arrays of the object that the next call overwrites.
    """

    def __init__(self, body: BodyNumbers, knots: int) -> None:
        state, toes, force = (ca.SX.sym(name, size) for name, size in _INPUTS)
        dt, mean = ca.SX.sym("dt"), ca.SX.sym("mean")
        after = knot_step(body, dt, mean, state, toes, force)
        jacobian = ca.jacobian(after, ca.vertcat(state, toes, force))
        # Column-major with knots last: read as (N, columns, rows) without a copy.
        step = ca.Function(
            "step",
            [state, toes, force, dt, mean],
            [ca.densify(after), ca.densify(jacobian)],
        ).map(knots)
        self.knots = knots
        self.state = np.zeros((knots, STATE))
        self.toes = np.zeros((knots, LEGS, 3))
        self.force = np.zeros((knots, LEGS, 3))
        self.dt = np.zeros(knots)
        self.mean = np.zeros(knots)
        self.after = np.zeros((knots, STATE))
        self._jacobian = np.zeros((knots, 36, STATE))
        self._step = _bound(
            step,
            [self.state, self.toes, self.force, self.dt, self.mean],
            [self.after, self._jacobian],
        )

    def linearise_step(self) -> None:
        """`after` and the Jacobians from state, toes, force, dt and mean."""
        self._step()

    @property
    def jacobian(self) -> Array:
        """(N, 36, 12) of `after`, transposed: by the state, the toes, the forces."""
        return self._jacobian

    @property
    def by_state(self) -> Array:
        """(N, 12, 12) of `after` by the state."""
        return self._jacobian[:, :12].transpose(0, 2, 1)

    @property
    def by_toes(self) -> Array:
        """(N, 12, 4, 3) of `after` by the toes."""
        return self._jacobian[:, 12:24].transpose(0, 2, 1).reshape(self.knots, 12, LEGS, 3)

    @property
    def by_force(self) -> Array:
        """(N, 12, 4, 3) of `after` by the forces."""
        return self._jacobian[:, 24:].transpose(0, 2, 1).reshape(self.knots, 12, LEGS, 3)


@dataclass(frozen=True)
class _Call:
    """A CasADi call together with what it reads and writes, which it does not keep alive."""

    call: Any
    kept: tuple[Any, ...]

    def __call__(self) -> None:
        self.call()


_INPUTS = (("state", STATE), ("toes", 3 * LEGS), ("force", 3 * LEGS))


@lru_cache(maxsize=16)
def knot_model(body: BodyNumbers, knots: int) -> KnotModel:
    """A model, built once for each body and number of knots; not to be shared by threads."""
    return KnotModel(body, knots)


def _bound(function: Any, inputs: list[Array], outputs: list[Array]) -> _Call:
    """The function as a call without arguments on these very arrays."""
    buffer, call = function.buffer()
    for k, array in enumerate(inputs):
        buffer.set_arg(k, memoryview(array))  # type: ignore[arg-type]
    for k, array in enumerate(outputs):
        buffer.set_res(k, memoryview(array))  # type: ignore[arg-type]
    return _Call(call, (function, buffer, *inputs, *outputs))
