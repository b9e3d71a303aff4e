"""What a tree is told of products: which rows hold them, their factors' cells and their envelopes.

The instance is taken with a variable for each product behind its own (`linear_in_products`), on a
box around all that is feasible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import Box, propagated_box
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.product_rows import linear_in_products
from climbplan.solvers.mixed_integer.spatial import Spatial

CELLS = 2**20  # of a factor's range: products in one are exact to 1e-12 of their own range
_ROOM = 1e-9  # relative: what rounding may have taken from a box
_FIXED = 1e-7  # relative width from which a factor's range is not divided


@dataclass(frozen=True)
class Factors:
    """An instance that is linear in its products, and how these hang together."""

    instance: Instance  # w of product q at places[q], tied to nothing
    products: Products
    places: IntArray  # (K,)
    weight: Array  # (K,) by how much a row may fail for each unit that w is off
    always: IntArray  # (K,) 1 where a plain row holds the product
    since: IntArray  # (K + 1,)
    binary: IntArray  # place of the integer that decides a conditional row, product by product
    value: IntArray
    space: IntArray  # (F,) factors that are no integers


def factors_of(instance: Instance) -> Factors | None:
    """Of an instance with products; None where its bounds cross when they are propagated.

    Raises UsageError for a factor that nothing bounds.
    """
    products, n = instance.products, instance.size
    box = propagated_box(instance)
    if (box.lower > box.upper).any() or (box.products.lower > box.products.upper).any():
        return None
    factors = np.unique(np.concatenate([products.first, products.second]))
    for i in factors:
        if not np.isfinite(box.upper[i] - box.lower[i]):
            raise UsageError(
                f"{instance.name}: variable {i} is a factor of a product and nothing bounds it, "
                "which branch-and-bound needs"
            )
    plain, implied = sparse.csc_matrix(instance.Q), sparse.csc_matrix(instance.implications.Q)
    conditional = [
        implied.indices[implied.indptr[q] : implied.indptr[q + 1]] for q in range(products.count)
    ]
    rows = np.concatenate([np.zeros(0, np.int64), *conditional]).astype(np.int64)
    return Factors(
        instance=_on(linear_in_products(instance), box),
        products=products,
        places=n + np.arange(products.count),
        weight=np.maximum(_weights(instance.Q), _weights(instance.implications.Q)),
        always=(np.diff(plain.indptr) > 0).astype(np.int64),
        since=np.concatenate([[0], np.cumsum([len(c) for c in conditional])]).astype(np.int64),
        binary=instance.implications.binary[rows],
        value=instance.implications.value[rows].astype(np.int64),
        space=factors[~instance.integer[factors]],
    )


def _weights(Q: sparse.csr_matrix) -> Array:
    """(K,) largest entry of each product times how many products its row holds."""
    rows = sparse.csr_matrix(abs(Q))
    count = np.diff(rows.indptr)
    most = np.zeros(rows.shape[1])
    np.maximum.at(most, rows.indices, rows.data * np.repeat(count, count))
    return most


def _on(linear: Instance, box: Box) -> Instance:
    """The instance on a box, with a little room for rounding."""
    low = np.concatenate([box.lower, box.products.lower])
    high = np.concatenate([box.upper, box.products.upper])
    low = low - _ROOM * np.maximum(1.0, np.abs(low))
    high = high + _ROOM * np.maximum(1.0, np.abs(high))
    whole = linear.integer
    return replace(
        linear,
        lower=np.where(whole, linear.lower, np.maximum(low, linear.lower)),
        upper=np.where(whole, linear.upper, np.minimum(high, linear.upper)),
    )


@dataclass(frozen=True)
class Cells:
    """How the ranges of factors are divided."""

    left: Array  # (F,)
    width: Array  # (F,) of a cell
    count: IntArray  # (F,)

    @classmethod
    def of(cls, lower: Array, upper: Array) -> Cells:
        """Of ranges (F,)."""
        size = np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
        width = np.maximum(upper - lower, _ROOM * size)
        count = np.where(width > _FIXED * size, CELLS, 1)
        return cls(0.5 * (lower + upper - width), width / count, count.astype(np.int64))


def no_products(entities: int, k: int) -> Spatial:
    """Of a program without products."""
    whole, real = np.zeros(0, np.int64), np.zeros(0)
    return Spatial(
        first=whole,
        second=whole,
        place=whole,
        begin=whole,
        vector=np.zeros((0, 3, k)),
        base=np.zeros((0, 3)),
        weight=real,
        always=np.zeros(0, np.uint8),
        since=np.zeros(1, np.int64),
        entity=whole,
        value=whole,
        left=np.zeros(entities),
        cell=np.zeros(entities),
        area=real,
        last=np.zeros((0, 4)),
    )


def spatial_numbers(
    factors: Factors,
    number: IntArray,
    integers: int,
    cells: Cells,
    start: Array,
    over_v: Array,
    stated: int,
) -> Spatial:
    """Of a program whose stated rows are followed by those of factors, products and envelopes.

    number: (size,) entity of each place. start, over_v: (size,), (size, k) each place at w = 0 and
    over v. stated: rows before the first factor's.
    """
    products, K, F = factors.products, factors.products.count, len(factors.space)
    of = np.stack([factors.places, products.first, products.second], axis=1)
    ends = cells.width * cells.count
    wide = np.ones(len(number))
    wide[factors.space] = ends
    return Spatial(
        first=number[products.first],
        second=number[products.second],
        place=stated + F + np.arange(K),
        begin=stated + F + K + 4 * np.arange(K),
        vector=np.ascontiguousarray(over_v[of]),
        base=start[of],
        weight=factors.weight,
        always=factors.always.astype(np.uint8),
        since=factors.since,
        entity=number[factors.binary],
        value=factors.value,
        left=np.concatenate([np.zeros(integers), cells.left]),
        cell=np.concatenate([np.zeros(integers), cells.width]),
        area=np.maximum(0.25 * wide[products.first] * wide[products.second], 1e-300),
        last=np.full((K, 4), np.nan),
    )
