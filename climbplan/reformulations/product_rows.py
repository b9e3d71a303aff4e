"""Products as variables of their own, and the envelope rows that bound them on a box.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance, Products
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.envelopes import Squares, build_halfspaces
from climbplan.reformulations.extension import Extension, TripletRows, extend_instance
from climbplan.reformulations.grids import Partition


def linearise_products(instance: Instance) -> Instance:
    """Return the instance with a variable for each product after its own, without w = x y."""
    n, K = instance.size, instance.products.count
    implications = instance.implications
    no_index = np.zeros(0, np.int64)
    without_products = replace(
        instance,
        products=Products(no_index, no_index),
        Q=sparse.csr_matrix((instance.A.shape[0], 0)),
        implications=replace(implications, Q=sparse.csr_matrix((implications.count, 0))),
    )
    product_variables = Extension(
        np.where(instance.products.first == instance.products.second, 0.0, -np.inf),
        np.full(K, np.inf),
        np.zeros(K, bool),
        sparse.csr_matrix((0, n + K)),
        np.zeros(0),
        np.zeros(0),
    )
    extended_instance = extend_instance(without_products, product_variables)
    lift = sparse.hstack([sparse.csr_matrix((K, n)), sparse.identity(K)]).tocsr()
    return replace(
        extended_instance,
        A=(extended_instance.A + instance.Q @ lift).tocsr(),
        implications=replace(
            extended_instance.implications,
            A=(extended_instance.implications.A + implications.Q @ lift).tocsr(),
        ),
    )


Unbounded = Literal["refuse", "open"]
"""Treatment of factors without bounds."""


def compute_factor_bounds(
    instance: Instance, partitions: tuple[Partition, ...], unbounded: Unbounded = "refuse"
) -> ElementwiseRange:
    """Return bounds of all variables; propagated where a factor has neither bounds nor pieces.

    Raises:
        UsageError: A factor of a product has no bounds, unless it may be open.
    """
    products = instance.products
    low, high = instance.lower.copy(), instance.upper.copy()
    for partition in partitions:
        low[partition.variables] = partition.lower.min(axis=0)
        high[partition.variables] = partition.upper.max(axis=0)
    factors = np.unique(np.concatenate([products.first, products.second]))
    missing = factors[~(np.isfinite(low[factors]) & np.isfinite(high[factors]))]
    if len(missing):
        box = propagate_box(instance)
        low[missing], high[missing] = box.lower[missing], box.upper[missing]
        unbounded_factors = missing[~(np.isfinite(low[missing]) & np.isfinite(high[missing]))]
        if len(unbounded_factors) and unbounded == "refuse":
            raise UsageError(
                f"{instance.name}: variable {unbounded_factors[0]} is a factor of a product and "
                "has neither bounds nor a grid"
            )
    return ElementwiseRange(low, high)


def append_envelope_rows(
    rows: TripletRows,
    products: Products,
    which: IntArray,
    box: ElementwiseRange,
    n: int,
    squares: Squares,
) -> None:
    """Append eq. (8.26) for the products `which`; planes without a bound are left out."""
    if not len(which):
        return
    i, j = products.first[which], products.second[which]
    with np.errstate(invalid="ignore"):  # zero times an open end
        planes = build_halfspaces(
            box.lower[i], box.upper[i], box.lower[j], box.upper[j], i == j, squares
        )
    is_finite = np.isfinite(planes.a) & np.isfinite(planes.b) & np.isfinite(planes.d)
    product = np.broadcast_to(np.arange(len(which))[:, None], is_finite.shape)[is_finite]
    row = np.arange(len(product))
    entries = [
        (row, i[product], planes.a[is_finite]),
        (row, j[product], planes.b[is_finite]),
        (row, n + which[product], planes.c[is_finite]),
    ]
    rows.add(len(row), entries, -np.inf, planes.d[is_finite])
