"""The rigid body's rates, its discrete-time step, and the step's Jacobian, compiled.

The machine code is generated from the formulation in `walking/dynamics/dynamics.py`, eqs. (8.14) to
(8.19), and its derivatives by CasADi, without C. Tests compare it with `truth.py`.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.generated import create_kernel
from climbplan.walking.dynamics import dynamics
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.parameters import ForcedMotion
from climbplan.walking.task.task import BodyParameters


def _symbols() -> tuple[dynamics.Body, list[Any]]:
    """Return a symbolic body and the inputs: its parameters, state (12,), and contact wrench.

    The parameters are mass, gravity, inertia and its inverse (9,) row by row: one code serves all
    bodies. The wrench of any number of legs is the sum of their forces (3,) and of their moments
    about the world's origin (3,).
    """
    mass, gravity = ca.SX.sym("mass"), ca.SX.sym("gravity")
    inertia, inverse = ca.SX.sym("inertia", 9), ca.SX.sym("inverse", 9)
    tensors = (ca.reshape(inertia, 3, 3).T, ca.reshape(inverse, 3, 3).T)
    point = [ca.SX.sym("state", 12), ca.SX.sym("push", 3), ca.SX.sym("about_origin", 3)]
    body = dynamics.BodySymbols(mass, gravity, tensors)
    return body, [mass, gravity, inertia, inverse, *point]


def _rates() -> Any:
    """Return the function of the state's time derivative (12,)."""
    body, inputs = _symbols()
    return ca.Function("rates", inputs, ca.cse([dynamics.state_derivative(body, *inputs[4:])]))


def _step(mean: float, with_jacobian: bool) -> Any:
    """Return the function of the next state (12,), and optionally of its Jacobian (12, 18)."""
    body, inputs = _symbols()
    dt, point = ca.SX.sym("dt"), inputs[4:]
    outputs = [dynamics.knot_step(body, dt, mean, *point)]
    if with_jacobian:
        outputs.append(ca.jacobian(outputs[0], ca.vertcat(*point)))
    return ca.Function("step", [*inputs, dt], ca.cse(outputs))


rates = create_kernel(_rates)
euler_step, mean_step = (create_kernel(partial(_step, mean, False)) for mean in (0.0, 1.0))
_euler_jacobian, _mean_jacobian = (create_kernel(partial(_step, mean, True)) for mean in (0.0, 1.0))


@compiled
def sum_contact_wrench(toes: Array, force: Array, push: Array, about_origin: Array) -> None:
    """Write the sum (3,) of forces (L, 3) and that of their moments about the world's origin."""
    push[:], about_origin[:] = 0.0, 0.0
    for leg in range(force.shape[0]):
        x, y, z = toes[leg]
        fx, fy, fz = force[leg]
        push += force[leg]
        about_origin[0] += y * fz - z * fy
        about_origin[1] += z * fx - x * fz
        about_origin[2] += x * fy - y * fx


@compiled
def _expand_wrench_jacobian(toes: Array, force: Array, slopes: Array, jacobian: Array) -> None:
    """Write derivatives by state, toes and forces (12 + 6 L, 12) from those by state and wrench.

    By the chain rule: a toe changes the moment alone, by e x f for a unit vector e. A force changes
    the force by itself and the moment by toe x e.

    Args:
        toes: (L, 3) world frame [m].
        force: (L, 3) world frame [N].
        slopes: (18, 12) derivatives by state and wrench.
        jacobian: (12 + 6 L, 12) output.
    """
    legs = force.shape[0]
    for i in range(12):
        for j in range(12):
            jacobian[i, j] = slopes[i, j]
    for leg in range(legs):
        toe_row, force_row = 12 + 3 * leg, 12 + 3 * (legs + leg)
        x, y, z = toes[leg]
        fx, fy, fz = force[leg]
        for i in range(12):
            mx, my, mz = slopes[15, i], slopes[16, i], slopes[17, i]
            jacobian[toe_row, i] = fy * mz - fz * my
            jacobian[toe_row + 1, i] = fz * mx - fx * mz
            jacobian[toe_row + 2, i] = fx * my - fy * mx
            jacobian[force_row, i] = slopes[12, i] + z * my - y * mz
            jacobian[force_row + 1, i] = slopes[13, i] + x * mz - z * mx
            jacobian[force_row + 2, i] = slopes[14, i] + y * mx - x * my


@compiled
def linearise_steps(
    body: BodyParameters,
    steps: Array,
    use_mean: bool,
    motion: ForcedMotion,
    after: Array,
    jacobian: Array,
) -> None:
    """Linearise the discrete-time dynamics at N knots.

    Args:
        body: mass properties.
        steps: (N,) lengths of the intervals [s].
        use_mean: integrator `mean`, else forward Euler.
        motion: point of linearisation.
        after: (N, 12) output, C-ordered: states one interval later.
        jacobian: (N, 12 + 6 L, 12) output, C-ordered: derivatives by state, toes and forces.
    """
    state, toes, force = motion.state, motion.toes, motion.force
    # Generated code needs C-ordered arrays, and copies are.
    inertia, inverse = body.inertia.copy(), body.inverse_inertia.copy()
    x, push, about_origin, slopes = np.empty(12), np.empty(3), np.empty(3), np.empty((18, 12))
    for n in range(force.shape[0]):
        for k in range(12):
            x[k] = state[n, k]
        sum_contact_wrench(toes[n], force[n], push, about_origin)
        inputs = (body.mass, body.gravity, inertia, inverse, x, push, about_origin, steps[n])
        if use_mean:
            _mean_jacobian(inputs, (after[n], slopes))
        else:
            _euler_jacobian(inputs, (after[n], slopes))
        _expand_wrench_jacobian(toes[n], force[n], slopes, jacobian[n])
