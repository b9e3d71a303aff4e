"""A growing mixed-integer linear program, every row in a named block.

For programs that are stated as numbers, with thousands of rows in milliseconds: where a
reformulation is missing, or numbers change in place in a hot loop. The names are those of the
problem's exact check, so an answer, a conflict or a message can name the constraint.
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
from climbplan.program.residuals import BlockResidual, RowNames, compute_violation, find_worst_entry

Number = int | np.integer[Any]
Term = tuple[Number, float]  # column, coefficient
Terms = tuple[NDArray[np.integer[Any]], Array | float]  # of many rows: columns, coefficients


@dataclass(frozen=True)
class Block:
    """Position of rows that were added together, and of their coefficients row by row."""

    rows: slice
    values: slice


class LinearRows:
    """A growing program: bounds, integrality and cost of columns; named rows between two bounds."""

    repeats = True  # whether a column may occur in a row several times

    def __init__(self, units: Mapping[str, str] | None = None) -> None:
        """Begin without rows; `units` are those of the rows of a block by its name."""
        self.lower: list[float] = []
        self.upper: list[float] = []
        self.integer: list[bool] = []
        self.cost: list[float] = []
        self.constant = 0.0  # of the cost
        self._units = units or {}
        self._number: dict[str, int] = {}  # of each block
        # Entries row by row, in the compact form of the sparse matrix
        self._block = array("i")
        self._start = array("i", [0])
        self._index, self._value = array("i"), array("d")
        self._row_lower, self._row_upper = array("d"), array("d")

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._block)

    def columns(
        self, shape: tuple[int, ...], lower: float, upper: float, integer: bool = False
    ) -> IntArray:
        """Add columns with the same bounds; return their indices in an array of that shape."""
        count = int(np.prod(shape))
        first = len(self.lower)
        self.lower += [lower] * count
        self.upper += [upper] * count
        self.integer += [integer] * count
        self.cost += [0.0] * count
        return np.arange(first, first + count).reshape(shape)

    def binaries(self, shape: tuple[int, ...]) -> IntArray:
        """Add binary columns."""
        return self.columns(shape, 0.0, 1.0, integer=True)

    def bound(self, column: Number, lower: float, upper: float) -> None:
        """Set the bounds of a column."""
        self.lower[column], self.upper[column] = float(lower), float(upper)

    def row(self, name: str, terms: Iterable[Term], lower: float, upper: float) -> None:
        """Add lower <= sum of terms <= upper to the block of that name."""
        index, value = self._index, self._value
        for column, coefficient in terms:
            index.append(int(column))
            value.append(coefficient)
        self._start.append(len(index))
        self._block.append(self._number.setdefault(name, len(self._number)))
        self._row_lower.append(lower)
        self._row_upper.append(upper)

    def equal(self, name: str, terms: Iterable[Term], value: float = 0.0) -> None:
        """Add sum of terms = value."""
        self.row(name, terms, value, value)

    def at_most(self, name: str, terms: Iterable[Term], value: float = 0.0) -> None:
        """Add sum of terms <= value."""
        self.row(name, terms, -np.inf, value)

    def within(
        self, name: str, terms: list[Term], max_value: float, opened: Iterable[Term], by: float
    ) -> None:
        """Add |sum of terms| <= most + by * (sum of opened); opened terms deactivate the rows."""
        loose = [(column, by * coefficient) for column, coefficient in opened]
        self.row(name, [*terms, *((c, -v) for c, v in loose)], -np.inf, max_value)
        self.row(name, [*terms, *loose], -max_value, np.inf)

    def block(
        self,
        name: str,
        terms: Sequence[Terms],
        low: Array | float = 0.0,
        high: Array | float | None = None,
    ) -> Block:
        """Add a row for each entry of the terms' columns; equal to low without high.

        Coefficients and bounds are one number, or one for each row.
        """
        size, width = len(terms[0][0]), len(terms)
        index, value = np.empty((size, width), np.int32), np.empty((size, width))
        for k, (columns, coefficients) in enumerate(terms):
            index[:, k], value[:, k] = columns, coefficients
        first_row, first_entry = len(self), len(self._index)
        self._index.frombytes(index.tobytes())
        self._value.frombytes(value.tobytes())
        ends = np.arange(first_entry + width, first_entry + width * size + 1, width, dtype=np.int32)
        self._start.frombytes(ends.tobytes())
        number = self._number.setdefault(name, len(self._number))
        self._block.extend([number] * size)
        both = (self._row_lower, low), (self._row_upper, low if high is None else high)
        for bounds, bound in both:
            bounds.frombytes(np.broadcast_to(np.asarray(bound, float), (size,)).tobytes())
        return Block(
            slice(first_row, first_row + size), slice(first_entry, first_entry + width * size)
        )

    @property
    def row_lower(self) -> Array:
        """Lower bounds (m,)."""
        return np.array(self._row_lower)

    @property
    def row_upper(self) -> Array:
        """Upper bounds (m,)."""
        return np.array(self._row_upper)

    def entries(self) -> tuple[IntArray, IntArray, Array]:
        """Return row, column and coefficient of each term, in the order of addition."""
        row = np.repeat(np.arange(len(self)), np.diff(self._start))
        return row, np.array(self._index, np.int64), np.array(self._value)

    def matrix(self) -> sparse.csr_matrix:
        """Return all rows; entries of the same column in a row are summed if there may be some."""
        arrays = np.array(self._value), np.array(self._index), np.array(self._start)
        matrix = sparse.csr_matrix(arrays, shape=(len(self), len(self.lower)))
        if self.repeats:
            matrix.sum_duplicates()
        return matrix

    def tail(self, first: int) -> sparse.csr_matrix:
        """Return the rows from an index on, in which no column occurs several times."""
        start = np.array(self._start[first:])
        begin = int(start[0])
        arrays = np.array(self._value[begin:]), np.array(self._index[begin:]), start - begin
        return sparse.csr_matrix(arrays, shape=(len(self) - first, len(self.lower)))

    def forget(self, first: int) -> None:
        """Remove the rows from an index on."""
        begin = self._start[first]
        del self._start[first + 1 :], self._index[begin:], self._value[begin:]
        del self._block[first:], self._row_lower[first:], self._row_upper[first:]

    @property
    def names(self) -> RowNames:
        """Names of the blocks, and the block of each row."""
        units = tuple(self._units.get(name, "") for name in self._number)
        return RowNames(tuple(self._number), units, np.array(self._block))

    def residuals(self, x: Array) -> tuple[BlockResidual, ...]:
        """Return the worst violation of each block at x (n,), of bounds and of integrality."""
        row_violation = compute_violation(self.matrix() @ x, self.row_lower, self.row_upper)
        bound_violation = compute_violation(x, np.array(self.lower), np.array(self.upper))
        fraction = np.where(self.integer, np.abs(x - np.round(x)), 0.0)
        columns = (
            find_worst_entry("bounds", bound_violation, ""),
            find_worst_entry("integrality", fraction, ""),
        )
        return (*self.names.residuals(row_violation), *columns)

    def worst(self, x: Array) -> BlockResidual:
        """Return the block with the largest violation at x (n,)."""
        return max(self.residuals(x), key=lambda block: block.residual)
