"""Data of products for a tree: the rows that contain them, cells of factors, and envelopes.

The instance is taken with a variable for each product after its own (`linearise_products`), on a
box that contains all feasible points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.product_rows import linearise_products
from climbplan.solvers.mixed_integer.spatial import Spatial

CELLS = 2**20  # of a factor's range, so that products in a cell are exact to 1e-12 of their range
_ROOM = 1e-9  # relative margin of a box against rounding
_FIXED = 1e-7  # relative width below which a factor's range is not divided


@dataclass(frozen=True)
class ProductFactors:
    """An instance that is linear in its products, and the factors of these."""

    instance: Instance  # w of product q is variable places[q], without w = x y
    products: Products
    places: IntArray  # (K,)
    weight: Array  # (K,) largest violation of a row for each unit of error of w
    is_unconditional: IntArray  # (K,) 1 where the product occurs in a plain row
    indicator_start: IntArray  # (K + 1,) begin of each product's indicator rows in the next two
    indicator: IntArray  # index of the integer that activates the row
    value: IntArray  # value at which it does
    space: IntArray  # (F,) factors that are no integers


def find_factors(instance: Instance) -> ProductFactors | None:
    """Find the factors of an instance's products; None where bounds prove infeasibility.

    Raises:
        UsageError: A factor of a product is not bounded.
    """
    products, n = instance.products, instance.size
    box = propagate_box(instance)
    if (box.lower > box.upper).any() or (box.products.lower > box.products.upper).any():
        return None
    factors = np.unique(np.concatenate([products.first, products.second]))
    for i in factors:
        if not np.isfinite(box.upper[i] - box.lower[i]):
            raise UsageError(
                f"{instance.name}: variable {i} is a factor of a product and nothing bounds it, "
                "which branch-and-bound needs"
            )
    unconditional, implied = (
        sparse.csc_matrix(instance.Q),
        sparse.csc_matrix(instance.implications.Q),
    )
    indicator_rows = [
        implied.indices[implied.indptr[q] : implied.indptr[q + 1]] for q in range(products.count)
    ]
    rows = np.concatenate([np.zeros(0, np.int64), *indicator_rows]).astype(np.int64)
    return ProductFactors(
        instance=_restrict_to_box(linearise_products(instance), box),
        products=products,
        places=n + np.arange(products.count),
        weight=np.maximum(_compute_weights(instance.Q), _compute_weights(instance.implications.Q)),
        is_unconditional=(np.diff(unconditional.indptr) > 0).astype(np.int64),
        indicator_start=np.concatenate([[0], np.cumsum([len(c) for c in indicator_rows])]).astype(
            np.int64
        ),
        indicator=instance.implications.binary[rows],
        value=instance.implications.value[rows].astype(np.int64),
        space=factors[~instance.integer[factors]],
    )


def _compute_weights(Q: sparse.csr_matrix) -> Array:
    """Return (K,) the largest entry of each product times the number of products in its row."""
    rows = sparse.csr_matrix(abs(Q))
    count = np.diff(rows.indptr)
    weight = np.zeros(rows.shape[1])
    np.maximum.at(weight, rows.indices, rows.data * np.repeat(count, count))
    return weight


def _restrict_to_box(linear: Instance, box: VariableBox) -> Instance:
    """Return the instance on a box with a margin for rounding."""
    low = np.concatenate([box.lower, box.products.lower])
    high = np.concatenate([box.upper, box.products.upper])
    low = low - _ROOM * np.maximum(1.0, np.abs(low))
    high = high + _ROOM * np.maximum(1.0, np.abs(high))
    integer = linear.integer
    return replace(
        linear,
        lower=np.where(integer, linear.lower, np.maximum(low, linear.lower)),
        upper=np.where(integer, linear.upper, np.minimum(high, linear.upper)),
    )


@dataclass(frozen=True)
class Cells:
    """Uniform division of the ranges of factors into cells."""

    left: Array  # (F,)
    width: Array  # (F,) width of a cell
    count: IntArray  # (F,)

    @classmethod
    def divide(cls, lower: Array, upper: Array) -> Cells:
        """Divide ranges (F,) into cells."""
        size = np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
        width = np.maximum(upper - lower, _ROOM * size)
        count = np.where(width > _FIXED * size, CELLS, 1)
        return cls(0.5 * (lower + upper - width), width / count, count.astype(np.int64))


def empty_spatial(entities: int, k: int) -> Spatial:
    """Return the data of a program without products."""
    no_index, no_number = np.zeros(0, np.int64), np.zeros(0)
    return Spatial(
        first=no_index,
        second=no_index,
        product_row=no_index,
        envelope_row=no_index,
        vector=np.zeros((0, 3, k)),
        base=np.zeros((0, 3)),
        weight=no_number,
        is_unconditional=np.zeros(0, np.uint8),
        indicator_start=np.zeros(1, np.int64),
        entity=no_index,
        value=no_index,
        left=np.zeros(entities),
        cell_width=np.zeros(entities),
        max_gap=no_number,
        last_box=np.zeros((0, 4)),
    )


def build_spatial(
    factors: ProductFactors,
    cells: Cells,
    *,
    entity_of: IntArray,
    num_integers: int,
    start: Array,
    over_v: Array,
    num_stated: int,
) -> Spatial:
    """Build the data of products, whose rows follow the stated ones.

    Args:
        factors: Factors of the products.
        cells: Division of the factors' ranges.
        entity_of: (size,) entity of each variable, -1 for none.
        num_integers: Number of integers among the entities.
        start: (size,) each variable at w = 0.
        over_v: (size, k) each variable over v.
        num_stated: Number of rows before those of factors, products and envelopes.
    """
    products, K, F = factors.products, factors.products.count, len(factors.space)
    variables = np.stack([factors.places, products.first, products.second], axis=1)
    range_width = cells.width * cells.count
    width = np.ones(len(entity_of))
    width[factors.space] = range_width
    return Spatial(
        first=entity_of[products.first],
        second=entity_of[products.second],
        product_row=num_stated + F + np.arange(K),
        envelope_row=num_stated + F + K + 4 * np.arange(K),
        vector=np.ascontiguousarray(over_v[variables]),
        base=start[variables],
        weight=factors.weight,
        is_unconditional=factors.is_unconditional.astype(np.uint8),
        indicator_start=factors.indicator_start,
        entity=entity_of[factors.indicator],
        value=factors.value,
        left=np.concatenate([np.zeros(num_integers), cells.left]),
        cell_width=np.concatenate([np.zeros(num_integers), cells.width]),
        max_gap=np.maximum(0.25 * width[products.first] * width[products.second], 1e-300),
        last_box=np.full((K, 4), np.nan),
    )
