"""Rows of a sparse program of which some coefficients change and the pattern does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.walking.task import Array, Whole

Terms = list[tuple[Whole, Array | float]]  # indices of unknowns and their coefficients


@dataclass(frozen=True)
class Block:
    """Where rows that were added together are, and their coefficients term by term."""

    rows: slice
    values: slice


class Rows:
    """Collects rows low <= sum of coefficient times unknown <= high."""

    def __init__(self, unknowns: int) -> None:
        self.unknowns, self.count, self._values = unknowns, 0, 0
        self._row: list[Whole] = []
        self._column: list[Whole] = []
        self._value: list[Array] = []
        self._low: list[Array] = []
        self._high: list[Array] = []

    def add(
        self,
        terms: Sequence[tuple[Whole, Array | float]],
        low: Array | float,
        high: Array | float | None = None,
    ) -> Block:
        """One row for each entry of the terms' indices (of one length); equal to low without high.

        Coefficients are one number or one a row.
        """
        size = len(terms[0][0])
        rows = self.count + np.arange(size, dtype=np.int64)
        for index, value in terms:
            self._row.append(rows)
            self._column.append(np.asarray(index, np.int64))
            self._value.append(np.broadcast_to(np.asarray(value, float), (size,)))
        self._low.append(np.broadcast_to(np.asarray(low, float), (size,)))
        upper = low if high is None else high
        self._high.append(np.broadcast_to(np.asarray(upper, float), (size,)))
        self.count += size
        self._values += size * len(terms)
        values = slice(self._values - size * len(terms), self._values)
        return Block(slice(self.count - size, self.count), values)

    def frozen(self) -> RowBlocks:
        """The pattern, ready for new numbers."""
        return RowBlocks(
            np.concatenate(self._row),
            np.concatenate(self._column),
            np.concatenate(self._value),
            np.concatenate(self._low),
            np.concatenate(self._high),
            self.unknowns,
        )


class RowBlocks:
    """Rows whose coefficients are given in the order in which they were added."""

    def __init__(
        self, row: Whole, column: Whole, value: Array, low: Array, high: Array, unknowns: int
    ) -> None:
        self.value, self.low, self.high = value.copy(), low.copy(), high.copy()
        key = column * len(low) + row
        kept, self._slot = np.unique(key, return_inverse=True)  # column by column
        rows, columns = kept % len(low), kept // len(low)
        start = np.searchsorted(columns, np.arange(unknowns + 1))
        self.matrix = sparse.csc_matrix(
            (np.zeros(len(kept)), rows, start), shape=(len(low), unknowns)
        )
        self.refresh()

    def refresh(self) -> None:
        """Write the coefficients into the matrix."""
        self.matrix.data[:] = np.bincount(
            self._slot, weights=self.value, minlength=len(self.matrix.data)
        )
