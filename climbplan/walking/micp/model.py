"""A mixed-integer linear program under construction, with squares in its cost as tangents."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.program.linear_rows import LinearRows

_LEAST_SHARE = 1e-4  # of a square that tangents are added to


class Lin:
    """A linear expression: coefficients by column, and a constant."""

    __slots__ = ("constant", "terms")

    def __init__(self, terms: dict[int, float] | None = None, constant: float = 0.0) -> None:
        self.terms = terms if terms is not None else {}
        self.constant = constant

    def __add__(self, other: Lin | float) -> Lin:
        return self.plus(other, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Lin | float) -> Lin:
        return self.plus(other, -1.0)

    def __rsub__(self, other: float) -> Lin:
        return (self * -1.0).plus(other, 1.0)

    def __mul__(self, factor: float) -> Lin:
        if factor == 0.0:
            return Lin()
        terms = {column: factor * value for column, value in self.terms.items()}
        return Lin(terms, factor * self.constant)

    __rmul__ = __mul__

    def plus(self, other: Lin | float, factor: float) -> Lin:
        """self + factor * other."""
        if not isinstance(other, Lin):
            return Lin(dict(self.terms), self.constant + factor * other)
        terms = dict(self.terms)
        for column, value in other.terms.items():
            terms[column] = terms.get(column, 0.0) + factor * value
        return Lin(terms, self.constant + factor * other.constant)

    @property
    def column(self) -> int:
        """The column of a variable."""
        (column,) = self.terms
        return column

    def at(self, x: Array) -> float:
        """Its value at a point."""
        return self.constant + sum(value * x[column] for column, value in self.terms.items())


def total(parts: Iterable[Lin]) -> Lin:
    """The sum of expressions."""
    terms: dict[int, float] = {}
    constant = 0.0
    for part in parts:
        constant += part.constant
        for column, value in part.terms.items():
            terms[column] = terms.get(column, 0.0) + value
    return Lin(terms, constant)


@dataclass
class Square:
    """weight value^2 / share from below by tangents; the value vanishes with its share."""

    name: str  # of the block of its tangents
    weight: float
    value: Lin
    share: Lin
    column: int  # of its epigraph


class LinearModel(LinearRows):
    """Columns and rows, with expressions for terms and squares in the cost."""

    repeats = False  # expressions have each column once

    def __init__(self, dearest: float = np.inf) -> None:
        """dearest: beyond what any square of a point that is asked for costs."""
        super().__init__()
        self.dearest = dearest
        self.squares: list[Square] = []

    def variable(self, lower: float, upper: float, whole: bool = False, cost: float = 0.0) -> Lin:
        """A new column."""
        self.lower.append(lower)
        self.upper.append(upper)
        self.integer.append(whole)
        self.cost.append(cost)
        return Lin({len(self.lower) - 1: 1.0})

    def add(self, name: str, expression: Lin, lower: float, upper: float) -> None:
        """lower <= expression <= upper, in the block of that name."""
        shift = expression.constant
        self.row(name, expression.terms.items(), lower - shift, upper - shift)

    def least(self, name: str, expression: Lin) -> None:
        """expression >= 0."""
        self.add(name, expression, 0.0, np.inf)

    def square(
        self,
        name: str,
        weight: float,
        value: Lin,
        ends: tuple[float, float],
        ratio: float,
        share: Lin | None = None,
        cost: float = 1.0,
    ) -> Lin:
        """weight value^2 / share; tangents within ends, each ratio times nearer to 0 than the last.

        ends: least and largest value for a share of 1. Returns what the square is, from below.

        Between two tangents the relative error is ((ratio - 1) / (ratio + 1))^2 at most.
        """
        if share is None and not value.terms:
            square = weight * value.constant**2
            self.constant += cost * square
            return Lin(constant=square)
        if weight == 0.0:
            return Lin()
        epigraph = self.variable(0.0, self.dearest, cost=cost)
        whole = share if share is not None else Lin(constant=1.0)
        self.squares.append(Square(name, weight, value, whole, epigraph.column))
        low, high = ends
        least, at = 0.02 * max(abs(low), abs(high)), max(abs(low), abs(high))
        points = []
        while at > least:
            points += [side for side in (at, -at) if low <= side <= high]
            at /= ratio
        points += [end for end in ends if least < abs(end) and end not in points]
        for point in points:
            self.tangent(self.squares[-1], point)
        return epigraph

    def tangent(self, square: Square, at: float) -> None:
        """One more tangent, at a value that belongs to a share of 1."""
        slope = 2.0 * at * square.weight
        below = square.value * slope - square.share * (square.weight * at * at)
        self.least(square.name, Lin({square.column: 1.0}) - below)

    def refine(self, x: Array, tolerance: float) -> int:
        """Tangents where a point has squares too small; how many."""
        before = len(self)
        for square in self.squares:
            share = square.share.at(x)
            if share < _LEAST_SHARE:
                continue
            value = square.value.at(x)
            if square.weight * value**2 / share - x[square.column] > tolerance:
                self.tangent(square, value / share)
        return len(self) - before
