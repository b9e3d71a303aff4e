"""The nonlinear rigid-body dynamics of the exact check, in plain NumPy.

They are written independently of the expressions that solvers differentiate, so that errors in one
of them show.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Integrator,
    RigidBody,
)

_NEXT_AXIS, _LAST_AXIS = np.array([1, 2, 0]), np.array([2, 0, 1])


def euler_rates(angles: Array, spin: Array) -> Array:
    """Return the rates of roll, pitch, yaw (..., 3) at an angular velocity (..., 3), eq. (8.17)."""
    sines, cosines = np.sin(angles), np.cos(angles)
    sp, sy, cp, cy = sines[..., 1], sines[..., 2], cosines[..., 1], cosines[..., 2]
    along = cy * spin[..., 0] + sy * spin[..., 1]
    roll = along / cp
    pitch = -sy * spin[..., 0] + cy * spin[..., 1]
    rates: Array = np.stack([roll, pitch, spin[..., 2] + sp * roll], axis=-1)
    return rates


def acceleration(body: RigidBody, force: Array) -> Array:
    """Return the acceleration of the body (..., 3) under forces (..., L, 3), eq. (8.14)."""
    result: Array = force.sum(axis=-2) / body.mass
    result[..., 2] -= body.gravity
    return result


def spin_acceleration(body: RigidBody, angles: Array, spin: Array, moment: Array) -> Array:
    """Return the angular acceleration (..., 3) under a moment (..., 3), world frame, eq. (8.15)."""
    R = rotation_world_body(angles)
    inertia = R @ body.inertia @ np.swapaxes(R, -1, -2)
    momentum = (inertia @ spin[..., None])[..., 0]
    net_moment = moment - _cross(spin, momentum)
    result: Array = np.linalg.solve(inertia, net_moment[..., None])[..., 0].astype(
        float, copy=False
    )
    return result


def moment(position: Array, toes: Array, force: Array) -> Array:
    """Return the moment of forces (..., L, 3) at toes (..., L, 3) about the body (..., 3)."""
    return _cross(toes - position[..., None, :], force).sum(axis=-2)


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (..., 3); `np.cross` is slower by its checks of shapes."""
    product: Array = (
        a[..., _NEXT_AXIS] * b[..., _LAST_AXIS] - a[..., _LAST_AXIS] * b[..., _NEXT_AXIS]
    )
    return product


def derivative(body: RigidBody, state: Array, toes: Array, force: Array) -> Array:
    """Return the time derivative (..., 12) of the state (..., 12)."""
    angles, spin = state[..., ANGLES], state[..., SPIN]
    net_moment = moment(state[..., POSITION], toes, force)
    return np.concatenate(
        [
            state[..., VELOCITY],
            acceleration(body, force),
            euler_rates(angles, spin),
            spin_acceleration(body, angles, spin, net_moment),
        ],
        axis=-1,
    )


def integrate_knot(
    body: RigidBody, integrator: Integrator, dt: float, state: Array, toes: Array, force: Array
) -> Array:
    """Return the states (..., 12) one knot later, eq. (8.19).

    Args:
        body: The body.
        integrator: `euler` is forward Euler. `mean` moves the body along a parabola under constant
            forces, and rotates it by Runge-Kutta with the moment arms of each stage, whose mean is
            exact. `rk4` integrates in continuous time.
        dt: Length of the interval [s].
        state: States (..., 12).
        toes: Toes (..., L, 3), world frame [m].
        force: Forces (..., L, 3), world frame [N].
    """
    if integrator == "rk4":
        return runge_kutta(body, dt, state, toes, force)
    position, velocity = state[..., POSITION], state[..., VELOCITY]
    angles, spin = state[..., ANGLES], state[..., SPIN]
    a = acceleration(body, force)
    if integrator == "euler":
        alpha = spin_acceleration(body, angles, spin, moment(position, toes, force))
        return np.concatenate(
            [
                position + dt * velocity,
                velocity + dt * a,
                angles + dt * euler_rates(angles, spin),
                spin + dt * alpha,
            ],
            axis=-1,
        )
    middle_moment = moment(position + 0.5 * dt * (velocity + 0.25 * dt * a), toes, force)
    end_position = position + dt * (velocity + 0.5 * dt * a)
    moments = (
        moment(position, toes, force),
        middle_moment,
        middle_moment,
        moment(end_position, toes, force),
    )
    start_rotation = np.concatenate([angles, spin], axis=-1)
    end_rotation, slope, stages = (
        start_rotation,
        np.zeros_like(start_rotation),
        (0.0, 0.5, 0.5, 1.0),
    )
    for stage_moment, stage, weight in zip(moments, stages, (1, 2, 2, 1), strict=True):
        stage_rotation = start_rotation + stage * dt * slope
        slope = np.concatenate(
            [
                euler_rates(stage_rotation[..., :3], stage_rotation[..., 3:]),
                spin_acceleration(
                    body, stage_rotation[..., :3], stage_rotation[..., 3:], stage_moment
                ),
            ],
            axis=-1,
        )
        end_rotation = end_rotation + dt / 6.0 * weight * slope
    return np.concatenate([end_position, velocity + dt * a, end_rotation], axis=-1)


def runge_kutta(body: RigidBody, dt: float, state: Array, toes: Array, force: Array) -> Array:
    """Return the states (..., 12) after dt under constant forces, by the classical fourth order."""
    k1 = derivative(body, state, toes, force)
    k2 = derivative(body, state + 0.5 * dt * k1, toes, force)
    k3 = derivative(body, state + 0.5 * dt * k2, toes, force)
    k4 = derivative(body, state + dt * k3, toes, force)
    return state + (dt / 6.0) * (k1 + 2 * k2 + 2 * k3 + k4)


def integrate_knots(
    body: RigidBody, integrator: Integrator, dt: float, start: Array, toes: Array, force: Array
) -> Array:
    """Return the states (N + 1, 12) under forces (>= N, L, 3) at toes, from a start (12,)."""
    states = np.empty((len(force) + 1, STATE))
    states[0] = start
    for n in range(len(force)):
        states[n + 1] = integrate_knot(body, integrator, dt, states[n], toes[n], force[n])
    return states


def integrate_continuously(
    body: RigidBody, dt: float, start: Array, toes: Array, force: Array, num_steps: int = 4
) -> Array:
    """Return the states (N + 1, ..., 12) in continuous time, by Runge-Kutta steps.

    Args:
        body: The body.
        dt: Length of an interval [s].
        start: First states (..., 12).
        toes: Toes (N, ..., L, 3), world frame [m].
        force: Forces (N, ..., L, 3), world frame [N].
        num_steps: Steps in each interval.
    """
    states = np.empty((len(force) + 1, *start.shape))
    states[0] = start
    for n in range(len(force)):
        state = states[n]
        for _ in range(num_steps):
            state = runge_kutta(body, dt / num_steps, state, toes[n], force[n])
        states[n + 1] = state
    return states


def transform_toes_to_body(state: Array, toes: Array) -> Array:
    """Return toes (..., L, 3) in the body frame: R^T (toe - p)."""
    R = rotation_world_body(state[..., ANGLES])
    return (toes - state[..., None, POSITION]) @ R
