"""The body's rates, its next state at a knot and the Jacobian of that, compiled.

Generated from the declaration in `walking/dynamics.py`, eqs. (8.14) to (8.19), and its derivatives
by CasADi, without C. Tests hold them against `truth.py`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from climbplan.solvers.generated import kernel
from climbplan.walking import dynamics
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task import Array


def _symbols() -> tuple[dynamics.Body, list[Any]]:
    """A body of symbols; what it is given by, then state, toes and force (12,).

    That is mass, gravity, inertia and its inverse (9,) row by row: one code serves all bodies.
    """
    mass, gravity = ca.SX.sym("mass"), ca.SX.sym("gravity")
    inertia, inverse = ca.SX.sym("inertia", 9), ca.SX.sym("inverse", 9)
    tensors = (ca.reshape(inertia, 3, 3).T, ca.reshape(inverse, 3, 3).T)
    point = [ca.SX.sym(name, 12) for name in ("state", "toes", "force")]
    body = dynamics.BodySymbols(mass, gravity, tensors)
    return body, [mass, gravity, inertia, inverse, *point]


def _rates() -> Any:
    """The state's time derivative (12,)."""
    body, given = _symbols()
    return ca.Function("rates", given, ca.cse([dynamics.derivative(body, *given[4:])]))


def _step(mean: float, slopes: bool) -> Any:
    """The state one knot later (12,) and, if asked for, its slopes (12, 36); dt is given last."""
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

    mean: as the integrator of that name, else forward Euler. state (>= N, 12), toes (>= N, 4, 3),
    force (N, 4, 3). Writes after (N, 12) and jacobian (N, 36, 12): by state, toes and forces, both
    C-ordered.
    """
    # Copies are C-ordered, which what is given need not be
    inertia, inverse = inertia.copy(), inverse.copy()
    x, spots, pushes = np.empty(12), np.empty((4, 3)), np.empty((4, 3))
    for n in range(force.shape[0]):
        x[:], spots[:], pushes[:] = state[n], toes[n], force[n]
        given = (mass, gravity, inertia, inverse, x, spots, pushes, steps[n])
        if mean:
            _mean_slopes(given, (after[n], jacobian[n]))
        else:
            _euler_slopes(given, (after[n], jacobian[n]))
