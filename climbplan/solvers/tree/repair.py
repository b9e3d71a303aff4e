"""Repair a nearly feasible point to full accuracy, with its integers fixed.

Newton steps on the products: each solves the convex problem with products linearised about the
previous point, with the least change. It completes points of solvers that work to 1e-6 in a row, of
complementarity relaxations and of envelopes.
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


def repair_point(
    instance: Instance,
    x: Array,
    assignment: IntArray | None = None,
    steps: int = _STEPS,
    tolerance: float = FEASIBILITY,
) -> Array:
    """Return the feasible point nearest to x with the integers and alternatives of x.

    Without products it is the best point with them instead. The point itself, with integers
    rounded, is returned if no better one is found, so callers have to check it.

    Args:
        instance: The instance.
        x: (n,) nearly feasible point.
        assignment: (C,) alternative of each choice, the least violated if missing.
        steps: Largest number of Newton steps.
        tolerance: Violation at which the point counts as feasible.
    """
    chosen = instance.assignment(x) if assignment is None else assignment
    best = np.where(instance.integer, np.round(x), x)
    iterate = best
    bilinear = instance.products.count > 0
    for _ in range(steps if bilinear else 1):
        if bilinear and instance.violation(best, chosen) <= tolerance:
            break
        solution = solve_convex(
            _linearise(instance, iterate, chosen, keep_cost=not bilinear), "clarabel"
        ).x
        if solution is None:
            break
        iterate = np.where(instance.integer, best, solution)
        if instance.violation(iterate, chosen) < max(tolerance, instance.violation(best, chosen)):
            best = iterate
    return best


def _linearise(instance: Instance, x: Array, chosen: IntArray, keep_cost: bool) -> Instance:
    """Build the convex instance with the integers of x fixed and products linearised about x."""
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
    implications = instance.implications
    is_active = implications.active(x)
    A = [
        instance.A + instance.Q @ slope,
        implications.A[is_active] + implications.Q[is_active] @ slope,
    ]
    shifts = [instance.Q @ w, implications.Q[is_active] @ w]
    lower = [instance.row_lower - shifts[0], implications.lower[is_active] - shifts[1]]
    upper = [instance.row_upper - shifts[0], implications.upper[is_active] - shifts[1]]
    for choice, k in zip(instance.choices, chosen, strict=True):
        polytope = choice.alternatives[k]
        A.append(sparse.csr_matrix(np.vstack([polytope.A, polytope.C])) @ choice.E)
        equal = polytope.c - polytope.C @ choice.e
        lower += [np.full(len(polytope.b), -np.inf), equal]
        upper += [polytope.b - polytope.A @ choice.e, equal]
    rows = sparse.vstack(A).tocsr()
    no_index = np.zeros(0, np.int64)
    empty = Implications(
        sparse.csr_matrix((0, n)),
        sparse.csr_matrix((0, 0)),
        np.zeros(0),
        np.zeros(0),
        no_index,
        no_index > 0,
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
        products=Products(no_index, no_index),
        Q=sparse.csr_matrix((rows.shape[0], 0)),
        implications=empty,
    )
