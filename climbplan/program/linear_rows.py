"""Columns and rows of a mixed-integer linear program as they are added, every row in a named block.

For programs that are stated as numbers, thousands of rows in milliseconds: where a reformulation is
missing, or numbers change in place in a hot loop. Names are those that the problem's exact check
gives the same constraint, so that an answer, a conflict or a message can say which one it is about.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.residuals import BlockResidual, RowNames, outside, worst_entry

Number = int | np.integer[Any]
Term = tuple[Number, float]  # column, coefficient
Terms = tuple[NDArray[np.integer[Any]], Array | float]  # of many rows: columns, coefficients


@dataclass(frozen=True)
class Block:
    """Where rows that were added together are, and their coefficients, row by row."""

    rows: slice
    values: slice


class LinearRows:
    """A growing program: bounds, integrality and cost of columns; named rows between two bounds."""

    repeats = True  # whether a column may stand in a row several times

    def __init__(self, units: Mapping[str, str] | None = None) -> None:
        """units: of the rows of a block, by its name; none where it is left out."""
        self.lower: list[float] = []
        self.upper: list[float] = []
        self.integer: list[bool] = []
        self.cost: list[float] = []
        self.constant = 0.0  # of the cost
        self._units = units or {}
        self._number: dict[str, int] = {}  # of each block
        # Entries row by row, as compact as they are handed on
        self._block = array("i")
        self._start = array("i", [0])
        self._index, self._value = array("i"), array("d")
        self._row_lower, self._row_upper = array("d"), array("d")

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self._block)

    def columns(
        self, shape: tuple[int, ...], lower: float, upper: float, integer: bool = False
    ) -> IntArray:
        """New columns with the same bounds; their numbers in an array of that shape."""
        count = int(np.prod(shape))
        first = len(self.lower)
        self.lower += [lower] * count
        self.upper += [upper] * count
        self.integer += [integer] * count
        self.cost += [0.0] * count
        return np.arange(first, first + count).reshape(shape)

    def binaries(self, shape: tuple[int, ...]) -> IntArray:
        """New binary columns."""
        return self.columns(shape, 0.0, 1.0, integer=True)

    def bound(self, column: Number, lower: float, upper: float) -> None:
        """Set the bounds of a column."""
        self.lower[column], self.upper[column] = float(lower), float(upper)

    def row(self, name: str, terms: Iterable[Term], lower: float, upper: float) -> None:
        """lower <= sum of terms <= upper, in the block of that name."""
        index, value = self._index, self._value
        for column, coefficient in terms:
            index.append(int(column))
            value.append(coefficient)
        self._start.append(len(index))
        self._block.append(self._number.setdefault(name, len(self._number)))
        self._row_lower.append(lower)
        self._row_upper.append(upper)

    def equal(self, name: str, terms: Iterable[Term], value: float = 0.0) -> None:
        """sum of terms = value."""
        self.row(name, terms, value, value)

    def at_most(self, name: str, terms: Iterable[Term], value: float = 0.0) -> None:
        """sum of terms <= value."""
        self.row(name, terms, -np.inf, value)

    def within(
        self, name: str, terms: list[Term], most: float, opened: Iterable[Term], by: float
    ) -> None:
        """|sum of terms| <= most + by * (sum of opened): opened terms switch the rows off."""
        loose = [(column, by * coefficient) for column, coefficient in opened]
        self.row(name, [*terms, *((c, -v) for c, v in loose)], -np.inf, most)
        self.row(name, [*terms, *loose], -most, np.inf)

    def block(
        self,
        name: str,
        terms: Sequence[Terms],
        low: Array | float = 0.0,
        high: Array | float | None = None,
    ) -> Block:
        """One row for each entry of the terms' columns (of one length); equal to low without high.

        Coefficients and bounds are one number or one a row.
        """
        size, width = len(terms[0][0]), len(terms)
        index, value = np.empty((size, width), np.int32), np.empty((size, width))
        for k, (columns, coefficients) in enumerate(terms):
            index[:, k], value[:, k] = columns, coefficients
        before, first = len(self), len(self._index)
        self._index.frombytes(index.tobytes())
        self._value.frombytes(value.tobytes())
        ends = np.arange(first + width, first + width * size + 1, width, dtype=np.int32)
        self._start.frombytes(ends.tobytes())
        number = self._number.setdefault(name, len(self._number))
        self._block.extend([number] * size)
        both = (self._row_lower, low), (self._row_upper, low if high is None else high)
        for bounds, given in both:
            bounds.frombytes(np.broadcast_to(np.asarray(given, float), (size,)).tobytes())
        return Block(slice(before, before + size), slice(first, first + width * size))

    @property
    def row_lower(self) -> Array:
        """(m,)."""
        return np.array(self._row_lower)

    @property
    def row_upper(self) -> Array:
        """(m,)."""
        return np.array(self._row_upper)

    def entries(self) -> tuple[IntArray, IntArray, Array]:
        """Row, column and coefficient of each term, in the order in which they were added."""
        row = np.repeat(np.arange(len(self)), np.diff(self._start))
        return row, np.array(self._index, np.int64), np.array(self._value)

    def matrix(self) -> sparse.csr_matrix:
        """All rows; entries of the same column in a row are added up, where there may be some."""
        parts = np.array(self._value), np.array(self._index), np.array(self._start)
        matrix = sparse.csr_matrix(parts, shape=(len(self), len(self.lower)))
        if self.repeats:
            matrix.sum_duplicates()
        return matrix

    def tail(self, first: int) -> sparse.csr_matrix:
        """Rows from that one on, where no column stands in a row several times."""
        start = np.array(self._start[first:])
        at = int(start[0])
        parts = np.array(self._value[at:]), np.array(self._index[at:]), start - at
        return sparse.csr_matrix(parts, shape=(len(self) - first, len(self.lower)))

    def forget(self, first: int) -> None:
        """Take back the rows from that one on."""
        at = self._start[first]
        del self._start[first + 1 :], self._index[at:], self._value[at:]
        del self._block[first:], self._row_lower[first:], self._row_upper[first:]

    @property
    def names(self) -> RowNames:
        """Of the blocks that there are, and the one of each row."""
        units = tuple(self._units.get(name, "") for name in self._number)
        return RowNames(tuple(self._number), units, np.array(self._block))

    def residuals(self, x: Array) -> tuple[BlockResidual, ...]:
        """Worst violation of each block at x (n,), as stated; of bounds and whole numbers last."""
        off = outside(self.matrix() @ x, self.row_lower, self.row_upper)
        beyond = outside(x, np.array(self.lower), np.array(self.upper))
        fraction = np.where(self.integer, np.abs(x - np.round(x)), 0.0)
        columns = worst_entry("bounds", beyond, ""), worst_entry("integrality", fraction, "")
        return (*self.names.residuals(off), *columns)

    def worst(self, x: Array) -> BlockResidual:
        """The block that x (n,) is furthest off."""
        return max(self.residuals(x), key=lambda block: block.residual)
