"""Envelopes on one box: the convex program that remains when all pieces are given.

With `FixedIntegerForm` this is the method `convex` of X. Lin (UCLA 2022) in its smallest form:
four rows for each product and no weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.envelopes import Squares, build_halfspaces
from climbplan.reformulations.mccormick import McCormick
from climbplan.reformulations.product_rows import compute_factor_bounds, linearise_products


@dataclass(frozen=True)
class LocalForm:
    """The matrices of an instance with a variable for each product, and the positions of envelopes.

    They are built once; boxes and right-hand sides only change numbers.
    """

    source: Instance
    linear: Instance  # with products as variables after the others, without w = x y
    squares: Squares
    indptr: IntArray  # of all rows: those of the instance, then four for each product
    indices: IntArray
    order: IntArray  # entry of the envelope coefficients for each stored number

    @classmethod
    def of(cls, instance: Instance, squares: Squares = "envelope") -> LocalForm:
        """Prepare an instance."""
        linear = linearise_products(instance)
        first, second = instance.products.first, instance.products.second
        K, n = instance.products.count, instance.size
        row = np.arange(4 * K).reshape(K, 4)
        is_no_square = first != second
        rows = np.concatenate([row.ravel(), row[is_no_square].ravel(), row.ravel()])
        columns = np.concatenate(
            [
                np.repeat(first, 4),
                np.repeat(second[is_no_square], 4),
                np.repeat(n + np.arange(K), 4),
            ]
        )
        label = np.arange(1.0, len(rows) + 1.0)
        labelled = sparse.csr_matrix((label, (rows, columns)), shape=(4 * K, n + K))
        instance_rows = sparse.csr_matrix(linear.A)
        return cls(
            source=instance,
            linear=replace(linear, A=instance_rows),
            squares=squares,
            indptr=np.concatenate(
                [instance_rows.indptr, instance_rows.indptr[-1] + labelled.indptr[1:]]
            ),
            indices=np.concatenate([instance_rows.indices, labelled.indices]),
            order=labelled.data.astype(np.int64) - 1,
        )

    def at(self, box: ElementwiseRange, numbers: Instance | None = None) -> Instance:
        """Return the instance with envelopes on the box, to which its variables are restricted.

        Args:
            box: Ranges of variables.
            numbers: Instance with the same matrices whose bounds and right-hand sides are used
                (another assignment of integers).

        Raises:
            UsageError: A factor is unbounded in the box.
        """
        source = self.source if numbers is None else numbers
        linear, products, n = self.linear, self.source.products, self.source.size
        i, j = products.first, products.second
        ends = box.lower[i], box.upper[i], box.lower[j], box.upper[j]
        if not np.isfinite(np.stack(ends)).all():
            raise UsageError(f"{self.source.name}: a factor of a product is not bounded in the box")
        square = i == j
        planes = build_halfspaces(*ends, square, self.squares)
        on_first = planes.a + np.where(square[:, None], planes.b, 0.0)
        values = np.concatenate([on_first.ravel(), planes.b[~square].ravel(), planes.c.ravel()])
        data = np.concatenate([linear.A.data, values[self.order]])
        m = linear.A.shape[0] + planes.d.size
        return replace(
            linear,
            lower=np.concatenate([np.maximum(box.lower, source.lower), linear.lower[n:]]),
            upper=np.concatenate([np.minimum(box.upper, source.upper), linear.upper[n:]]),
            A=sparse.csr_matrix((data, self.indices, self.indptr), shape=(m, linear.size)),
            row_lower=np.concatenate([source.row_lower, np.full(planes.d.size, -np.inf)]),
            row_upper=np.concatenate([source.row_upper, planes.d.ravel()]),
            Q=sparse.csr_matrix((m, 0)),
        )


@dataclass(frozen=True)
class LocalMcCormick(Reformulation[Reformulated]):
    """Plain envelopes on one box: the rest of `McCormick` when all pieces are given.

    `lower` and `upper` (n,) are the box; variables that are no factors may be unbounded in it.
    """

    lower: Array
    upper: Array
    squares: Squares = "envelope"

    @classmethod
    def of_pieces(
        cls, instance: Instance, mccormick: McCormick, pieces: IntArray
    ) -> LocalMcCormick:
        """Build the box of one piece of each partition, and of the bounds elsewhere."""
        box = compute_factor_bounds(instance, mccormick.partitions)
        low, high = box.lower, box.upper
        for partition, i in zip(mccormick.partitions, pieces, strict=True):
            low[partition.variables] = partition.lower[i]
            high[partition.variables] = partition.upper[i]
        return cls(low, high, mccormick.squares)

    def accepts(self, instance: Instance) -> bool:
        """Accept instances of the box's dimension whose factors it bounds."""
        return len(self.lower) == instance.size and super().accepts(instance)

    def apply(self, instance: Instance) -> Reformulated:
        """Build the envelopes; see `LocalForm` for many boxes.

        Raises:
            UsageError: A factor is unbounded in the box.
        """
        local = LocalForm.of(instance, self.squares).at(ElementwiseRange(self.lower, self.upper))
        covers_bounds = (self.lower <= instance.lower).all() and (
            self.upper >= instance.upper
        ).all()
        square = (instance.products.first == instance.products.second).any()
        relaxation = bool(covers_bounds) and not (bool(square) and self.squares == "secant")
        return Reformulated(local, instance.size, relaxation)
