"""A builder of mixed-integer linear programs whose cost has squares, approximated by tangents.

A square of a variable that vanishes with a binary is stated in perspective form (Frangioni and
Gentile 2006, Perspective cuts for a class of convex 0-1 mixed integer programs).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.program.linear_rows import LinearRows

_MIN_INDICATOR = 1e-4  # below which no tangents are added to a square
_MIN_TANGENT = 0.02  # of the largest value of a square, for the tangent nearest to 0


class LinExpr:
    """A linear expression: coefficients by column, and a constant."""

    __slots__ = ("constant", "terms")

    def __init__(self, terms: dict[int, float] | None = None, constant: float = 0.0) -> None:
        self.terms = terms if terms is not None else {}
        self.constant = constant

    def __add__(self, other: LinExpr | float) -> LinExpr:
        return self.add_scaled(other, 1.0)

    __radd__ = __add__

    def __sub__(self, other: LinExpr | float) -> LinExpr:
        return self.add_scaled(other, -1.0)

    def __rsub__(self, other: float) -> LinExpr:
        return (self * -1.0).add_scaled(other, 1.0)

    def __mul__(self, factor: float) -> LinExpr:
        if factor == 0.0:
            return LinExpr()
        terms = {column: factor * value for column, value in self.terms.items()}
        return LinExpr(terms, factor * self.constant)

    __rmul__ = __mul__

    def add_scaled(self, other: LinExpr | float, factor: float) -> LinExpr:
        """Return self + factor * other."""
        if not isinstance(other, LinExpr):
            return LinExpr(dict(self.terms), self.constant + factor * other)
        terms = dict(self.terms)
        for column, value in other.terms.items():
            terms[column] = terms.get(column, 0.0) + factor * value
        return LinExpr(terms, self.constant + factor * other.constant)

    @property
    def column(self) -> int:
        """The column of an expression that is one variable."""
        (column,) = self.terms
        return column

    def evaluate(self, x: Array) -> float:
        """Return the value of the expression at a point (n,)."""
        return self.constant + sum(value * x[column] for column, value in self.terms.items())


def sum_expressions(expressions: Iterable[LinExpr]) -> LinExpr:
    """Return the sum of expressions."""
    terms: dict[int, float] = {}
    constant = 0.0
    for expression in expressions:
        constant += expression.constant
        for column, value in expression.terms.items():
            terms[column] = terms.get(column, 0.0) + value
    return LinExpr(terms, constant)


@dataclass
class SquareTerm:
    """A square in perspective form: epigraph >= weight value^2 / indicator, by tangents.

    The value is zero if the indicator is.
    """

    name: str  # of the block of its tangents
    weight: float
    value: LinExpr
    indicator: LinExpr
    epigraph_column: int


class LinearModel(LinearRows):
    """Columns and rows of a program, from linear expressions and squares in the cost."""

    repeats = False  # expressions have each column once

    def __init__(self, max_square_cost: float = np.inf) -> None:
        """Create an empty model.

        Args:
            max_square_cost: Upper bound on the epigraph of each square.
        """
        super().__init__()
        self.max_square_cost = max_square_cost
        self.squares: list[SquareTerm] = []

    def add_variable(
        self, lower: float, upper: float, is_integer: bool = False, cost: float = 0.0
    ) -> LinExpr:
        """Add a column and return it as an expression."""
        self.lower.append(lower)
        self.upper.append(upper)
        self.integer.append(is_integer)
        self.cost.append(cost)
        return LinExpr({len(self.lower) - 1: 1.0})

    def add_constraint(self, name: str, expression: LinExpr, lower: float, upper: float) -> None:
        """Add the row lower <= expression <= upper to the block of that name."""
        shift = expression.constant
        self.row(name, expression.terms.items(), lower - shift, upper - shift)

    def add_nonnegative(self, name: str, expression: LinExpr) -> None:
        """Add the row expression >= 0 to the block of that name."""
        self.add_constraint(name, expression, 0.0, np.inf)

    def add_square(
        self,
        name: str,
        weight: float,
        value: LinExpr,
        value_range: tuple[float, float],
        tangent_ratio: float,
        *,
        indicator: LinExpr | None = None,
        cost: float = 1.0,
    ) -> LinExpr:
        """Add an outer approximation of weight value^2 / indicator by tangents.

        Between two tangents the relative error is at most ((ratio - 1) / (ratio + 1))^2.

        Args:
            name: Name of the block of tangents.
            weight: Weight of the square.
            value: The expression that is squared.
            value_range: Least and largest value for an indicator of 1.
            tangent_ratio: Ratio of the points of tangency, from the ends of the range towards 0.
            indicator: Relaxed binary that the value vanishes with; None: 1.
            cost: Coefficient of the square in the cost.

        Returns:
            The epigraph variable, a lower bound on the square.
        """
        if indicator is None and not value.terms:
            square = weight * value.constant**2
            self.constant += cost * square
            return LinExpr(constant=square)
        if weight == 0.0:
            return LinExpr()
        epigraph = self.add_variable(0.0, self.max_square_cost, cost=cost)
        indicator = indicator if indicator is not None else LinExpr(constant=1.0)
        self.squares.append(SquareTerm(name, weight, value, indicator, epigraph.column))
        low, high = value_range
        smallest, point = _MIN_TANGENT * max(abs(low), abs(high)), max(abs(low), abs(high))
        points = []
        while point > smallest:
            points += [side for side in (point, -point) if low <= side <= high]
            point /= tangent_ratio
        points += [end for end in value_range if smallest < abs(end) and end not in points]
        for point in points:
            self.add_tangent(self.squares[-1], point)
        return epigraph

    def add_tangent(self, square: SquareTerm, point: float) -> None:
        """Add the tangent of a square at a value, for an indicator of 1."""
        slope = 2.0 * point * square.weight
        tangent = square.value * slope - square.indicator * (square.weight * point * point)
        self.add_nonnegative(square.name, LinExpr({square.epigraph_column: 1.0}) - tangent)

    def add_violated_tangents(self, x: Array, tolerance: float) -> int:
        """Add tangents of all squares whose epigraph is too small at a point.

        Args:
            x: The point (n,).
            tolerance: Largest violation that is accepted, in units of the cost.

        Returns:
            The number of tangents.
        """
        first_new_row = len(self)
        for square in self.squares:
            indicator = square.indicator.evaluate(x)
            if indicator < _MIN_INDICATOR:
                continue
            value = square.value.evaluate(x)
            if square.weight * value**2 / indicator - x[square.epigraph_column] > tolerance:
                self.add_tangent(square, value / indicator)
        return len(self) - first_new_row
