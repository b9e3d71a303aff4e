"""Named rows and costs, and one knot of a trajectory as a function of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array


@dataclass(frozen=True)
class NamedRowBounds:
    """Some rows of a block, after those that were stated earlier."""

    name: str
    unit: str
    lower: Array
    upper: Array


class NamedRows:
    """Rows and costs by name, under construction."""

    def __init__(self, symbols: Any) -> None:
        self._symbols = symbols
        self._rows: list[NamedRowBounds] = []
        self._expressions: list[Any] = []
        self._costs: dict[str, Any] = {}

    def between(
        self,
        name: str,
        expression: Any,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
    ) -> None:
        """Add lower <= expression <= upper, elementwise; the expression may be empty."""
        column = ca.vec(expression)
        shape = (column.numel(),)
        low = np.broadcast_to(np.asarray(lower, float), shape)
        high = np.broadcast_to(np.asarray(upper, float), shape)
        self._rows.append(NamedRowBounds(name, unit, low, high))
        self._expressions.append(column)

    def equal(self, name: str, expression: Any, unit: str = "") -> None:
        """Add expression == 0, elementwise."""
        self.between(name, expression, 0.0, 0.0, unit)

    def minimise(self, name: str, term: Any) -> None:
        """Add a term to a named cost."""
        self._costs[name] = self._costs.get(name, self._symbols(0)) + term

    def sizes(self) -> dict[str, int]:
        """Return the number of rows of every block."""
        sizes: dict[str, int] = {}
        for rows in self._rows:
            sizes[rows.name] = sizes.get(rows.name, 0) + len(rows.lower)
        return sizes


class Stage(NamedRows):
    """One knot's rows and costs, stated once and called at each knot by `StagedProgram.add`.

    A stage is a function of columns. Every row and cost has a name.
    """

    def __init__(self, name: str, inputs: Mapping[str, Any]) -> None:
        """Begin with input symbols (`ca.SX`) of any shape, by name and in this order."""
        super().__init__(ca.SX)
        self.name = name
        self.inputs = tuple(inputs)
        self._inputs = [ca.vec(symbol) for symbol in inputs.values()]

    @property
    def num_rows(self) -> int:
        """Number m of rows."""
        return sum(len(rows.lower) for rows in self._rows)

    def get_expressions(self) -> tuple[list[Any], Any, Any]:
        """Return the inputs, the rows (m,) and the costs (c,) as expressions of the inputs."""
        outputs = (ca.vertcat(*self._expressions), ca.vertcat(*self._costs.values()))
        rows, costs = (ca.densify(out) for out in outputs)
        return list(self._inputs), rows, costs

    def function(self) -> Any:
        """Return the ca.Function: columns -> (rows (m,), costs (c,))."""
        inputs, *outputs = self.get_expressions()
        return ca.Function(self.name, inputs, outputs)
