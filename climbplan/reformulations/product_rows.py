"""Products as variables of their own, and the plain envelope rows that hold them on a box."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.errors import UsageError
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance, Products
from climbplan.program.row_propagation import Range
from climbplan.reformulations.envelopes import Squares, halfspaces
from climbplan.reformulations.extension import Extension, RowStack, extended
from climbplan.reformulations.grids import Partition


def linear_in_products(instance: Instance) -> Instance:
    """The instance with a variable for each product behind its own, and nothing that ties them."""
    n, K = instance.size, instance.products.count
    implied = instance.implications
    none = np.zeros(0, np.int64)
    bare = replace(
        instance,
        products=Products(none, none),
        Q=sparse.csr_matrix((instance.A.shape[0], 0)),
        implications=replace(implied, Q=sparse.csr_matrix((implied.count, 0))),
    )
    free = Extension(
        np.where(instance.products.first == instance.products.second, 0.0, -np.inf),
        np.full(K, np.inf),
        np.zeros(K, bool),
        sparse.csr_matrix((0, n + K)),
        np.zeros(0),
        np.zeros(0),
    )
    wide = extended(bare, free)
    lift = sparse.hstack([sparse.csr_matrix((K, n)), sparse.identity(K)]).tocsr()
    return replace(
        wide,
        A=(wide.A + instance.Q @ lift).tocsr(),
        implications=replace(wide.implications, A=(wide.implications.A + implied.Q @ lift).tocsr()),
    )


Unbounded = Literal["refuse", "open"]
"""What becomes of factors that nothing bounds."""


def factor_bounds(
    instance: Instance, partitions: tuple[Partition, ...], unbounded: Unbounded = "refuse"
) -> Range:
    """Stated bounds of all variables, propagated ones where a factor without partition has none.

    Raises UsageError if a factor of a product has neither, unless it may be open.
    """
    products = instance.products
    low, high = instance.lower.copy(), instance.upper.copy()
    for partition in partitions:
        low[partition.variables] = partition.lower.min(axis=0)
        high[partition.variables] = partition.upper.max(axis=0)
    factors = np.unique(np.concatenate([products.first, products.second]))
    missing = factors[~(np.isfinite(low[factors]) & np.isfinite(high[factors]))]
    if len(missing):
        box = propagated_box(instance)
        low[missing], high[missing] = box.lower[missing], box.upper[missing]
        still = missing[~(np.isfinite(low[missing]) & np.isfinite(high[missing]))]
        if len(still) and unbounded == "refuse":
            raise UsageError(
                f"{instance.name}: variable {still[0]} is a factor of a product and has neither "
                "bounds nor a grid"
            )
    return Range(low, high)


def plain_rows(
    rows: RowStack,
    products: Products,
    which: IntArray,
    box: Range,
    n: int,
    squares: Squares,
) -> None:
    """Eq. (8.26) for the products numbered by `which`; planes without a bound are left out."""
    if not len(which):
        return
    i, j = products.first[which], products.second[which]
    with np.errstate(invalid="ignore"):  # zero times an open end
        planes = halfspaces(box.lower[i], box.upper[i], box.lower[j], box.upper[j], i == j, squares)
    kept = np.isfinite(planes.a) & np.isfinite(planes.b) & np.isfinite(planes.d)
    product = np.broadcast_to(np.arange(len(which))[:, None], kept.shape)[kept]
    at = np.arange(len(product))
    entries = [
        (at, i[product], planes.a[kept]),
        (at, j[product], planes.b[kept]),
        (at, n + which[product], planes.c[kept]),
    ]
    rows.add(len(at), entries, -np.inf, planes.d[kept])
