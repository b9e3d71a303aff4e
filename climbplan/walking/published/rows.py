"""Rows of a sparse program of which some coefficients change and the pattern does not."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.linear_rows import LinearRows
from climbplan.program.residuals import BlockResidual, outside


class ChangingRows:
    """Rows as they were stated, ready for new numbers: coefficients in the order of stating."""

    def __init__(self, stated: LinearRows) -> None:
        row, column, self.value = stated.entries()
        self.low, self.high, self.names = stated.row_lower, stated.row_upper, stated.names
        count = len(self.low)
        kept, self._slot = np.unique(column * count + row, return_inverse=True)  # by columns
        rows, columns = kept % count, kept // count
        unknowns = len(stated.lower)
        start = np.searchsorted(columns, np.arange(unknowns + 1))
        self.matrix = sparse.csc_matrix((np.zeros(len(kept)), rows, start), shape=(count, unknowns))
        self.refresh()

    def refresh(self) -> None:
        """Write the coefficients into the matrix."""
        self.matrix.data[:] = np.bincount(
            self._slot, weights=self.value, minlength=len(self.matrix.data)
        )

    def residuals(self, x: Array) -> tuple[BlockResidual, ...]:
        """Worst violation of each block at x (n,), with the numbers of the last refresh."""
        return self.names.residuals(outside(self.matrix @ x, self.low, self.high))
