"""The two stages of the coupled planner through CVXPY: what a modelling layer costs."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.program.blocks import Variable
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.local_envelopes import LocalForm


def cvxpy_stages(
    pinned: Instance, within: ElementwiseRange, force: Variable, one_by_one: bool = False
) -> float:
    """P1, then P2 at its postures, both by Clarabel; returns P1's cost.

    one_by_one: a constraint for every ball, as limbs and rounds are written down, instead of one
    for all balls from matrices that are there.
    """
    import cvxpy

    cp: Any = cvxpy

    local = LocalForm.of(pinned).at(within)
    x = cp.Variable(local.size)
    problem = cp.Problem(cp.Minimize(_cost(cp, local, x)), _constraints(cp, local, x, one_by_one))
    value = float(problem.solve(solver=cp.CLARABEL))
    n = pinned.size
    y = cp.Variable(n)
    first, second = pinned.products.first, pinned.products.second
    given = np.asarray(x.value)[:n]
    free = (first >= force.start) & (first < force.stop)
    known, other = np.where(free, second, first), np.where(free, first, second)
    products = cp.multiply(given[known], y[other])
    row = pinned.A @ y + pinned.Q @ products
    kept = np.ones(n, bool)
    kept[force.start : force.stop] = False
    rows = _between(row, pinned.row_lower - 1e-7, pinned.row_upper + 1e-7)
    within_bounds = _between(y[~kept], pinned.lower[~kept], pinned.upper[~kept])
    cp.Problem(cp.Minimize(0), [*rows, *within_bounds, y[kept] == given[kept]]).solve(
        solver=cp.CLARABEL
    )
    return value


def _cost(cp: Any, instance: Instance, x: Any) -> Any:
    quadratic = cp.quad_form(x, instance.P, assume_PSD=True)
    return 0.5 * quadratic + instance.q @ x + instance.constant


def _between(row: Any, lower: Any, upper: Any) -> list[Any]:
    low, high = np.isfinite(lower), np.isfinite(upper)
    return [row[low] >= lower[low], row[high] <= upper[high]]


def _constraints(cp: Any, instance: Instance, x: Any, one_by_one: bool) -> list[Any]:
    out = _between(instance.A @ x, instance.row_lower, instance.row_upper)
    out += _between(x, instance.lower, instance.upper)
    for balls in instance.balls:
        d = balls.f.shape[1]
        if one_by_one:
            out += [
                cp.norm(balls.F[k * d : (k + 1) * d] @ x + balls.f[k], 2) <= radius
                for k, radius in enumerate(balls.radius)
            ]
            continue
        vectors = cp.reshape(balls.F @ x, (balls.count, d), order="C") + balls.f
        out.append(cp.norm(vectors, 2, axis=1) <= balls.radius)
    return out
