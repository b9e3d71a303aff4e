"""Columns and rows of a mixed-integer linear program as they are added."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.limms.scene import Array, Index

Number = int | np.integer[Any]
Term = tuple[Number, float]  # column, coefficient


@dataclass
class Table:
    """A growing program: bounds, integrality and cost of columns; rows between two bounds."""

    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    integer: list[bool] = field(default_factory=list)
    cost: list[float] = field(default_factory=list)
    row_lower: list[float] = field(default_factory=list)
    row_upper: list[float] = field(default_factory=list)
    _start: list[int] = field(default_factory=lambda: [0])
    _index: list[int] = field(default_factory=list)
    _value: list[float] = field(default_factory=list)

    def columns(
        self, shape: tuple[int, ...], lower: float, upper: float, integer: bool = False
    ) -> Index:
        """New columns with the same bounds; their numbers in an array of that shape."""
        count = int(np.prod(shape))
        first = len(self.lower)
        self.lower += [lower] * count
        self.upper += [upper] * count
        self.integer += [integer] * count
        self.cost += [0.0] * count
        return np.arange(first, first + count).reshape(shape)

    def binaries(self, shape: tuple[int, ...]) -> Index:
        """New binary columns."""
        return self.columns(shape, 0.0, 1.0, integer=True)

    def bound(self, column: Number, lower: float, upper: float) -> None:
        """Set the bounds of a column."""
        self.lower[column], self.upper[column] = float(lower), float(upper)

    def row(self, terms: Iterable[Term], lower: float, upper: float) -> int:
        """lower <= sum of terms <= upper; the number of the row."""
        for column, coefficient in terms:
            self._index.append(int(column))
            self._value.append(float(coefficient))
        self._start.append(len(self._index))
        self.row_lower.append(float(lower))
        self.row_upper.append(float(upper))
        return len(self.row_lower) - 1

    def equal(self, terms: Iterable[Term], value: float = 0.0) -> None:
        """sum of terms = value."""
        self.row(terms, value, value)

    def at_most(self, terms: Iterable[Term], value: float = 0.0) -> None:
        """sum of terms <= value."""
        self.row(terms, -np.inf, value)

    def within(self, terms: list[Term], most: float, opened: Iterable[Term], by: float) -> None:
        """|sum of terms| <= most + by * (sum of opened): opened terms switch the rows off."""
        loose = [(column, by * coefficient) for column, coefficient in opened]
        self.row([*terms, *((c, -v) for c, v in loose)], -np.inf, most)
        self.row([*terms, *loose], -most, np.inf)

    def matrix(self) -> sparse.csr_matrix:
        """All rows; entries of the same column in a row are added up."""
        shape = (len(self.row_lower), len(self.lower))
        matrix = sparse.csr_matrix(
            (np.array(self._value), np.array(self._index), np.array(self._start)), shape=shape
        )
        matrix.sum_duplicates()
        return matrix

    @property
    def binary(self) -> NDArray[np.bool_]:
        """Which columns are integer."""
        return np.array(self.integer)

    def numbers(self) -> tuple[Array, Array, Array]:
        """Cost, lower and upper bounds of the columns."""
        return np.array(self.cost), np.array(self.lower), np.array(self.upper)
