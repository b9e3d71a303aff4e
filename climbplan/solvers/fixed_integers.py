"""Convex instances that remain once the integers and alternatives of an instance are fixed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Implications, Instance, Products


def fix_integers(instance: Instance, x: Array, assignment: IntArray) -> Instance:
    """Return the convex instance with the integers of x (n,) and an assignment (C,) fixed.

    instance: An instance without products.
    """
    return linearise_products(instance, x, assignment, keep_cost=True)


def linearise_products(instance: Instance, x: Array, chosen: IntArray, keep_cost: bool) -> Instance:
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
