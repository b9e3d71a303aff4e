"""An instance with integers, products and implications written out for SCIP: the tests' oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyscipopt

from climbplan.arrays import Array
from climbplan.program import Instance
from climbplan.reformulations.conditional_rows import build_indicator_rows, compute_big_m


def scip_optimum(instance: Instance, time_limit: float = 20.0) -> Array | None:
    """A global optimum x (n,), None if SCIP proves that there is none."""
    model = pyscipopt.Model()
    model.hideOutput()
    model.setParam("limits/time", time_limit)
    model.setParam("limits/gap", 1e-4)
    model.setParam("parallel/maxnthreads", 1)
    x = [
        model.addVar(vtype="B" if kind else "C", lb=_end(low), ub=_end(high))
        for kind, low, high in zip(instance.integer, instance.lower, instance.upper, strict=True)
    ]
    d = [[model.addVar(vtype="B") for _ in c.alternatives] for c in instance.choices]
    for group in d:
        model.addCons(pyscipopt.quicksum(group) == 1)
    v = [*x, *(b for group in d for b in group)]
    w = list(zip(instance.products.first, instance.products.second, strict=True))

    def row(A: Any, Q: Any, i: int) -> Any:
        terms = [float(a) * x[j] for j, a in zip(A[i].indices, A[i].data, strict=True)]
        terms += [
            float(a) * x[w[k][0]] * x[w[k][1]] for k, a in zip(Q[i].indices, Q[i].data, strict=True)
        ]
        return pyscipopt.quicksum(terms)

    def least(expression: Any, bound: float, sign: float = 1.0) -> None:
        if np.isfinite(bound):
            model.addCons(sign * expression >= sign * float(bound))

    for i in range(instance.A.shape[0]):
        least(row(instance.A, instance.Q, i), instance.row_lower[i])
        least(row(instance.A, instance.Q, i), instance.row_upper[i], -1.0)
    rows = build_indicator_rows(instance)
    reach = compute_big_m(instance, rows)
    for i in range(len(rows.upper)):
        off = 1 - v[rows.indicator[i]] if rows.value[i] else v[rows.indicator[i]]
        value = row(rows.A, rows.Q, i)
        least(value + float(reach.below[i]) * off, rows.lower[i])
        least(value - float(reach.above[i]) * off, rows.upper[i], -1.0)
    # One epigraph a square: a single large quadratic would leave SCIP's bound at zero.
    value, vector = np.linalg.eigh(instance.P.toarray())
    terms = [float(a) * b for a, b in zip(instance.q, x, strict=True) if a]
    blocks = _diagonal(instance) or [
        np.sqrt(a) * column for a, column in zip(value, vector.T, strict=True) if a > 1e-9
    ]
    for column in blocks:
        height, step = model.addVar(lb=0.0), model.addVar(lb=None)
        used = np.flatnonzero(np.abs(column) > 1e-12)
        model.addCons(step == pyscipopt.quicksum(float(column[j]) * x[j] for j in used))
        model.addCons(step * step <= height)
        terms.append(0.5 * height)
    model.setObjective(pyscipopt.quicksum(terms))
    model.optimize()
    if model.getNSols() == 0:
        return None
    return np.array([model.getVal(b) for b in x])


def _diagonal(instance: Instance) -> list[Array]:
    """Rows of a Cholesky factor if P is positive definite where it is not zero, else none."""
    P = instance.P.toarray()
    used = np.flatnonzero(P.diagonal())
    try:
        factor = np.linalg.cholesky(P[np.ix_(used, used)]).T
    except np.linalg.LinAlgError:
        return []
    out = np.zeros((len(used), len(P)))
    out[:, used] = factor
    return list(out)


def _end(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
