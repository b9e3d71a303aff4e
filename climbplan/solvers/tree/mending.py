"""A nearly feasible point made feasible to full accuracy with its integers kept.

Newton steps on the products: each is the convex problem with the products linear about the point
before, least change first. Solvers that work to 1e-6 in a row, complementarity relaxations and
envelopes all end here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Implications, Instance, Products
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.result import FEASIBILITY

_STEPS = 8


def mended(
    instance: Instance,
    x: Array,
    assignment: IntArray | None = None,
    steps: int = _STEPS,
    tolerance: float = FEASIBILITY,
) -> Array:
    """The feasible point nearest to x with the integers and alternatives of x.

    Without products the best one with them instead. The point itself, integers rounded, if nothing
    better is found: callers judge it.
    """
    chosen = instance.assignment(x) if assignment is None else assignment
    best = np.where(instance.integer, np.round(x), x)
    at = best
    bilinear = instance.products.count > 0
    for _ in range(steps if bilinear else 1):
        if bilinear and instance.violation(best, chosen) <= tolerance:
            break
        found = solve_convex(_linear(instance, at, chosen, keep_cost=not bilinear), "clarabel").x
        if found is None:
            break
        at = np.where(instance.integer, best, found)
        if instance.violation(at, chosen) < max(tolerance, instance.violation(best, chosen)):
            best = at
    return best


def _linear(instance: Instance, x: Array, chosen: IntArray, keep_cost: bool) -> Instance:
    """Rows that hold at the integers of x, products linear about x: convex."""
    n, products = instance.size, instance.products
    number = np.arange(products.count)
    slope = sparse.csr_matrix(
        (
            np.concatenate([x[products.second], x[products.first]]),
            (np.tile(number, 2), np.concatenate([products.first, products.second])),
        ),
        shape=(products.count, n),
    )
    w = -products.values(x)  # x_i x_j is about x_i^0 x_j + x_j^0 x_i - x_i^0 x_j^0
    implied = instance.implications
    held = implied.active(x)
    A = [instance.A + instance.Q @ slope, implied.A[held] + implied.Q[held] @ slope]
    shifts = [instance.Q @ w, implied.Q[held] @ w]
    lower = [instance.row_lower - shifts[0], implied.lower[held] - shifts[1]]
    upper = [instance.row_upper - shifts[0], implied.upper[held] - shifts[1]]
    for choice, k in zip(instance.choices, chosen, strict=True):
        polytope = choice.alternatives[k]
        A.append(sparse.csr_matrix(np.vstack([polytope.A, polytope.C])) @ choice.E)
        equal = polytope.c - polytope.C @ choice.e
        lower += [np.full(len(polytope.b), -np.inf), equal]
        upper += [polytope.b - polytope.A @ choice.e, equal]
    rows = sparse.vstack(A).tocsr()
    none = np.zeros(0, np.int64)
    empty = Implications(
        sparse.csr_matrix((0, n)),
        sparse.csr_matrix((0, 0)),
        np.zeros(0),
        np.zeros(0),
        none,
        none > 0,
    )
    fixed = instance.integer
    return replace(
        instance,
        P=instance.P if keep_cost else sparse.identity(n, format="csc"),
        q=instance.q if keep_cost else -x,
        lower=np.where(fixed, np.round(x), instance.lower),
        upper=np.where(fixed, np.round(x), instance.upper),
        A=rows,
        row_lower=np.concatenate(lower),
        row_upper=np.concatenate(upper),
        choices=(),
        integer=np.zeros(n, bool),
        products=Products(none, none),
        Q=sparse.csr_matrix((rows.shape[0], 0)),
        implications=empty,
    )
