"""All assignments of a small instance, each solved by CVXPY: an oracle that shares no code."""

from __future__ import annotations

import itertools

import cvxpy as cp
import numpy as np

from climbplan.program import Instance


def brute_force(instance: Instance) -> float:
    """The optimum, infinite if no assignment is feasible."""
    counts = (range(len(c.alternatives)) for c in instance.choices)
    return min(convex_optimum(instance, chosen) for chosen in itertools.product(*counts))


def convex_optimum(instance: Instance, chosen: tuple[int, ...]) -> float:
    """The optimum of one assignment, infinite if it is infeasible."""
    x = cp.Variable(instance.size)
    held = [x >= instance.lower, x <= instance.upper]
    if instance.A.shape[0]:
        row = instance.A @ x
        low, high = np.isfinite(instance.row_lower), np.isfinite(instance.row_upper)
        if low.any():
            held.append(row[low] >= instance.row_lower[low])
        if high.any():
            held.append(row[high] <= instance.row_upper[high])
    for balls in instance.balls:
        d = balls.f.shape[1]
        for k in range(balls.count):
            vector = balls.F[k * d : (k + 1) * d] @ x + balls.f[k]
            held.append(cp.norm(vector) <= balls.radius[k])
    for choice, r in zip(instance.choices, chosen, strict=True):
        y, polytope = choice.E @ x + choice.e, choice.alternatives[r]
        if len(polytope.b):
            held.append(polytope.A @ y <= polytope.b)
        if len(polytope.c):
            held.append(polytope.C @ y == polytope.c)
    cost = 0.5 * cp.quad_form(x, cp.psd_wrap(instance.P)) + instance.q @ x + instance.constant
    problem = cp.Problem(cp.Minimize(cost), held)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return float(problem.value) if problem.status in ("optimal", "optimal_inaccurate") else np.inf
