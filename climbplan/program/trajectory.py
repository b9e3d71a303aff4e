"""A smooth program over phases and knots, stated piece by piece: every row and cost has a name.

For programs without integers that are built once and solved with other numbers, or whose
expressions are too large to be scalars (`Program` holds those, and integers beside them): functions
of CasADi are built once and called at each knot. A name may be used again and again; all its rows
are one block.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from climbplan.program.polytope import Array
from climbplan.program.residuals import BlockResidual


@dataclass(frozen=True)
class _Piece:
    """Some rows of a block."""

    name: str
    unit: str
    expression: Any  # a column
    lower: Array
    upper: Array


@dataclass
class Trajectory:
    """minimise the sum of named costs subject to named rows on variables with starts and bounds.

    symbols: `ca.MX`, matrices and calls of functions, or `ca.SX`, one graph of scalars.
    """

    name: str
    symbols: Any = ca.MX
    _x: list[Any] = field(default_factory=list, repr=False)
    _p: list[Any] = field(default_factory=list, repr=False)
    _start: list[Array] = field(default_factory=list, repr=False)
    _lower: list[Array] = field(default_factory=list, repr=False)
    _upper: list[Array] = field(default_factory=list, repr=False)
    _pieces: list[_Piece] = field(default_factory=list, repr=False)
    _costs: dict[str, Any] = field(default_factory=dict, repr=False)

    def variable(self, name: str, start: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Any:
        """A column of variables, one an entry of `start`, which is brought into the bounds."""
        value = np.atleast_1d(np.asarray(start, float))
        symbol = self.symbols.sym(name, len(value))
        self._x.append(symbol)
        self._lower.append(np.broadcast_to(np.asarray(lower, float), value.shape))
        self._upper.append(np.broadcast_to(np.asarray(upper, float), value.shape))
        self._start.append(np.clip(value, self._lower[-1], self._upper[-1]))
        return symbol

    def parameter(self, name: str, rows: int, columns: int = 1) -> Any:
        """Numbers that are given when it is solved, column by column, in order of statement."""
        symbol = self.symbols.sym(name, rows, columns)
        self._p.append(symbol)
        return symbol

    def between(
        self,
        name: str,
        expression: Any,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
    ) -> None:
        """lower <= expression <= upper, elementwise."""
        column = ca.vec(expression)
        shape = (column.numel(),)
        low = np.broadcast_to(np.asarray(lower, float), shape)
        high = np.broadcast_to(np.asarray(upper, float), shape)
        self._pieces.append(_Piece(name, unit, column, low, high))

    def equal(self, name: str, expression: Any, unit: str = "") -> None:
        """expression == 0, elementwise."""
        self.between(name, expression, 0.0, 0.0, unit)

    def minimise(self, name: str, term: Any) -> None:
        """Add a term to a named cost."""
        self._costs[name] = self._costs.get(name, self.symbols(0)) + term

    @property
    def x(self) -> Any:
        """(N,) all variables, in the order in which they were stated."""
        return ca.vertcat(*self._x)

    @property
    def p(self) -> Any:
        """(P,) all parameters, in the order in which they were stated."""
        if not self._p:
            return self.symbols.sym("p", 0)
        return ca.vertcat(*(ca.vec(symbol) for symbol in self._p))

    @property
    def rows(self) -> Any:
        """(M,) all rows, in the order in which they were stated."""
        return ca.vertcat(*(piece.expression for piece in self._pieces))

    @property
    def cost(self) -> Any:
        """The sum of all costs."""
        return sum(self._costs.values(), self.symbols(0))

    @property
    def start(self) -> Array:
        """(N,)."""
        return np.concatenate([np.zeros(0), *self._start])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Of the variables, (N,) each."""
        return (
            np.concatenate([np.zeros(0), *self._lower]),
            np.concatenate([np.zeros(0), *self._upper]),
        )

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Of the rows, (M,) each."""
        return (
            np.concatenate([np.zeros(0), *(piece.lower for piece in self._pieces)]),
            np.concatenate([np.zeros(0), *(piece.upper for piece in self._pieces)]),
        )

    def residuals(self, rows: Array) -> tuple[BlockResidual, ...]:
        """Worst violation of every block at values of the rows (M,); which of its rows it is."""
        worst: dict[str, BlockResidual] = {}
        counted: dict[str, int] = {}
        at = 0
        for piece in self._pieces:
            value = rows[at : at + len(piece.lower)]
            at += len(piece.lower)
            off = np.maximum(np.maximum(piece.lower - value, value - piece.upper), 0.0)
            off = np.where(np.isnan(value), np.inf, off)
            before = counted.get(piece.name, 0)
            counted[piece.name] = before + len(off)
            k = int(np.argmax(off)) if len(off) else 0
            here = float(off[k]) if len(off) else 0.0
            if piece.name not in worst or here > worst[piece.name].residual:
                worst[piece.name] = BlockResidual(piece.name, here, piece.unit, (before + k,))
        return tuple(worst.values())
