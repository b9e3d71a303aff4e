"""The body's rates, its next state at a knot and the Jacobian of that, compiled.

Generated from the declaration in `walking/dynamics/dynamics.py`, eqs. (8.14) to (8.19), and its
derivatives by CasADi, without C. Tests hold them against `truth.py`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.generated import kernel
from climbplan.walking.dynamics import dynamics
from climbplan.walking.kernels.compiling import compiled


def _symbols() -> tuple[dynamics.Body, list[Any]]:
    """A body of symbols; what it is given by, then its state (12,) and what legs do.

    That is mass, gravity, inertia and its inverse (9,) row by row: one code serves all bodies.
    Legs, however many, count by the sum of their forces (3,) and by that of their moments about the
    world's origin (3,).
    """
    mass, gravity = ca.SX.sym("mass"), ca.SX.sym("gravity")
    inertia, inverse = ca.SX.sym("inertia", 9), ca.SX.sym("inverse", 9)
    tensors = (ca.reshape(inertia, 3, 3).T, ca.reshape(inverse, 3, 3).T)
    point = [ca.SX.sym("state", 12), ca.SX.sym("push", 3), ca.SX.sym("about_origin", 3)]
    body = dynamics.BodySymbols(mass, gravity, tensors)
    return body, [mass, gravity, inertia, inverse, *point]


def _rates() -> Any:
    """The state's time derivative (12,)."""
    body, given = _symbols()
    return ca.Function("rates", given, ca.cse([dynamics.derivative(body, *given[4:])]))


def _step(mean: float, slopes: bool) -> Any:
    """The state one knot later (12,) and, if asked for, its slopes (12, 18); dt is given last."""
    body, given = _symbols()
    dt, point = ca.SX.sym("dt"), given[4:]
    outputs = [dynamics.knot_step(body, dt, mean, *point)]
    if slopes:
        outputs.append(ca.jacobian(outputs[0], ca.vertcat(*point)))
    return ca.Function("step", [*given, dt], ca.cse(outputs))


rates = kernel(_rates)
euler_step, mean_step = (kernel(partial(_step, mean, False)) for mean in (0.0, 1.0))
_euler_slopes, _mean_slopes = (kernel(partial(_step, mean, True)) for mean in (0.0, 1.0))


@compiled
def net_load(toes: Array, force: Array, push: Array, about_origin: Array) -> None:
    """Writes the sum (3,) of forces (L, 3) and that of their moments about the world's origin."""
    push[:], about_origin[:] = 0.0, 0.0
    for leg in range(force.shape[0]):
        x, y, z = toes[leg]
        fx, fy, fz = force[leg]
        push += force[leg]
        about_origin[0] += y * fz - z * fy
        about_origin[1] += z * fx - x * fz
        about_origin[2] += x * fy - y * fx


@compiled
def _by_legs(toes: Array, force: Array, slopes: Array, by: Array) -> None:
    """Slopes (18, 12) by state and load become those by state, toes and forces (12 + 6 L, 12).

    A toe moves the moment alone: by e x f for a unit e; a force adds itself, and toe x e.
    """
    legs = force.shape[0]
    for i in range(12):
        for j in range(12):
            by[i, j] = slopes[i, j]
    for leg in range(legs):
        at, pushed = 12 + 3 * leg, 12 + 3 * (legs + leg)
        x, y, z = toes[leg]
        fx, fy, fz = force[leg]
        for i in range(12):
            mx, my, mz = slopes[15, i], slopes[16, i], slopes[17, i]
            by[at, i] = fy * mz - fz * my
            by[at + 1, i] = fz * mx - fx * mz
            by[at + 2, i] = fx * my - fy * mx
            by[pushed, i] = slopes[12, i] + z * my - y * mz
            by[pushed + 1, i] = slopes[13, i] + x * mz - z * mx
            by[pushed + 2, i] = slopes[14, i] + y * mx - x * my


@compiled
def linearised(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    steps: Array,
    mean: bool,
    state: Array,
    toes: Array,
    force: Array,
    after: Array,
    jacobian: Array,
) -> None:
    """States one knot later and their slopes at N knots, steps (N,) [s] apart.

    mean: as the integrator of that name, else forward Euler. state (>= N, 12), toes (>= N, L, 3),
    force (N, L, 3). Writes after (N, 12) and jacobian (N, 12 + 6 L, 12): by state, toes and forces,
    both C-ordered.
    """
    # Copies are C-ordered, which what is given need not be
    inertia, inverse = inertia.copy(), inverse.copy()
    x, push, about_origin, slopes = np.empty(12), np.empty(3), np.empty(3), np.empty((18, 12))
    for n in range(force.shape[0]):
        for k in range(12):
            x[k] = state[n, k]
        net_load(toes[n], force[n], push, about_origin)
        given = (mass, gravity, inertia, inverse, x, push, about_origin, steps[n])
        if mean:
            _mean_slopes(given, (after[n], slopes))
        else:
            _euler_slopes(given, (after[n], slopes))
        _by_legs(toes[n], force[n], slopes, jacobian[n])
