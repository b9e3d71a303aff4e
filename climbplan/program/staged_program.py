"""A smooth program over phases and knots, stated piece by piece: every row and cost has a name.

For programs that are built once and solved with other numbers, or whose expressions are too large
to be scalars: functions of CasADi are built once and called at each knot (`Stage`). A name may be
used again and again; all its rows are one block. IPOPT takes such a program as it stands
(`climbplan.solvers.ipopt.staged_program`), every other method by scalars (`StagedProgram.program`).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, IntArray
from climbplan.program.layout import MatrixLayout
from climbplan.program.residuals import BlockResidual, RowNames, compute_violation
from climbplan.program.stage import NamedRows, Stage
from climbplan.program.stage_derivatives import (
    ProgramDerivatives,
    StageCall,
    build_stage_derivatives,
)
from climbplan.program.statement import Program


def _find_positions(name: str, names: list[str], sizes: list[int]) -> IntArray:
    """Return positions (K, d) of the K pieces of a name.

    Raises:
        KeyError: There are none.
        ValueError: The pieces have different sizes.
    """
    ends = np.cumsum(sizes)
    positions = [
        np.arange(e - d, e) for n, d, e in zip(names, sizes, ends, strict=True) if n == name
    ]
    if not positions:
        raise KeyError(name)
    return np.stack(positions)


class StagedProgram(NamedRows):
    """minimise the sum of named costs subject to named rows on variables with starts and bounds."""

    def __init__(self, name: str, symbols: Any = ca.MX) -> None:
        """symbols: `ca.MX`, matrices and calls of functions, or `ca.SX`, one graph of scalars."""
        super().__init__(symbols)
        self.name = name
        self._x: dict[str, Any] = {}
        self._named: list[str] = []  # of each variable as it was stated
        self._p: dict[str, Any] = {}
        self._start: list[Array] = []
        self._lower: list[Array] = []
        self._upper: list[Array] = []
        self._binary: list[bool] = []
        self._calls: list[StageCall] = []
        self._has_other_terms = False  # rows or costs that are of no stage

    def between(
        self,
        name: str,
        expression: Any,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
    ) -> None:
        """Add lower <= expression <= upper, elementwise; the expression may be empty."""
        self._has_other_terms = True
        super().between(name, expression, lower, upper, unit)

    def minimise(self, name: str, term: Any) -> None:
        """Add a term to a named cost."""
        self._has_other_terms = True
        super().minimise(name, term)

    def variable(
        self,
        name: str,
        start: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        binary: bool = False,
    ) -> Any:
        """A column of variables, one an entry of `start`, which is brought into the bounds.

        binary: 0 or 1; IPOPT has them between, see `relax`. A name that is stated again and again,
        as at every knot, is x, x.1, x.2, ... in `program`, and all of them in `place`.
        """
        value = np.atleast_1d(np.asarray(start, float))
        symbol = self._symbols.sym(name, len(value))
        before = self._named.count(name)
        unique = f"{name}.{before}" if before else name
        if unique in self._x:
            raise ValueError(f"{self.name}: {unique!r} is the name of another variable")
        self._x[unique] = symbol
        self._named.append(name)
        self._binary.append(binary)
        self._lower.append(np.broadcast_to(np.asarray(lower, float), value.shape))
        self._upper.append(np.broadcast_to(np.asarray(upper, float), value.shape))
        self._start.append(np.clip(value, self._lower[-1], self._upper[-1]))
        return symbol

    def binary(self, name: str, start: ArrayLike) -> Any:
        """A column of variables that are 0 or 1."""
        return self.variable(name, start, 0.0, 1.0, binary=True)

    def parameter(self, name: str, rows: int, columns: int = 1) -> Any:
        """Numbers that are given when it is solved, column by column, in order of statement."""
        if name in self._p:
            raise ValueError(f"{self.name}: parameter {name!r} is stated twice")
        self._p[name] = symbol = self._symbols.sym(name, rows, columns)
        return symbol

    def add(self, stage: Stage, *arguments: Any, **named: Any) -> None:
        """Add a stage at K knots: its rows knot after knot, its costs summed.

        Args:
            stage: The stage.
            arguments: A matrix (d, K) for each input, one column a knot, or (d, 1) where it is the
                same at all knots.
            named: Further inputs by name.

        Raises:
            ValueError: The arguments are not the inputs of the stage.
        """
        named_inputs = stage.inputs[len(arguments) :]
        if set(named_inputs) != set(named) or len(arguments) + len(named_inputs) != len(
            stage.inputs
        ):
            raise ValueError(f"{stage.name} takes {', '.join(stage.inputs)}")
        columns = (*arguments, *(named[name] for name in named_inputs))
        matrices = [ca.MX(a) if self._symbols is ca.MX else a for a in columns]
        knots = max(argument.size2() for argument in matrices)
        function = stage.function()
        if knots > 1:
            wide = [a if a.size2() == knots else ca.repmat(a, 1, knots) for a in matrices]
            rows, costs = function.map(knots)(*wide)
        else:
            rows, costs = function(*matrices)
        self._expressions.append(ca.vec(rows))
        self._rows += stage._rows * knots
        for name, term in zip(stage._costs, ca.vertsplit(ca.sum2(costs)), strict=True):
            super().minimise(name, term)
        self._calls.append(StageCall(stage, tuple(matrices), knots))

    def build_derivatives(self) -> ProgramDerivatives:
        """Build the derivatives of a program of stages from those of one knot of each.

        Raises:
            ValueError: It has rows or costs that are of no stage, or its symbols are scalars.
        """
        if self._has_other_terms or self._symbols is not ca.MX:
            raise ValueError(f"{self.name}: not all rows and costs are those of stages")
        return build_stage_derivatives(self.x, self.p, self._calls)

    def relax(self, eps: float) -> None:
        """Relax binaries by z (1 - z) <= eps, eq. (7.4), with rows after all others.

        It is for a local method, and called once when everything is stated.
        """
        binaries = [z for z, binary in zip(self._x.values(), self._binary, strict=True) if binary]
        z = ca.vertcat(*binaries)
        self.between("integers.whole", z * (1 - z), upper=eps)

    @property
    def x(self) -> Any:
        """All variables (N,), in the order of statement."""
        return ca.vertcat(*self._x.values())

    @property
    def p(self) -> Any:
        """All parameters (P,), in the order of statement."""
        if not self._p:
            return self._symbols.sym("p", 0)
        return ca.vertcat(*(ca.vec(symbol) for symbol in self._p.values()))

    def theta(self, values: Mapping[str, ArrayLike]) -> Array:
        """Return (P,) from numbers of every parameter, each of its shape."""
        shapes = {name: symbol.shape for name, symbol in self._p.items()}
        return MatrixLayout.of(shapes).pack(
            {name: np.asarray(v, float) for name, v in values.items()}
        )

    @property
    def rows(self) -> Any:
        """All rows (M,), in the order of statement."""
        return ca.vertcat(*self._expressions)

    @property
    def cost(self) -> Any:
        """Sum of all costs."""
        return sum(self._costs.values(), self._symbols(0))

    @property
    def start(self) -> Array:
        """Start of the variables (N,)."""
        return np.concatenate([np.zeros(0), *self._start])

    def guess(self) -> dict[str, Array]:
        """Return the stated starts by variable, for `Problem(start=lambda theta: ...)`."""
        return dict(zip(self._x, self._start, strict=True))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the variables, (N,) each."""
        return (
            np.concatenate([np.zeros(0), *self._lower]),
            np.concatenate([np.zeros(0), *self._upper]),
        )

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Bounds of the rows, (M,) each."""
        return (
            np.concatenate([np.zeros(0), *(rows.lower for rows in self._rows)]),
            np.concatenate([np.zeros(0), *(rows.upper for rows in self._rows)]),
        )

    def place(self, name: str) -> IntArray:
        """Return positions (K, d) in x of the variables that were stated K times by a name."""
        return _find_positions(name, self._named, [len(array) for array in self._start])

    def block(self, name: str) -> IntArray:
        """Return positions (K, m) of the rows of a block."""
        return _find_positions(
            name, [r.name for r in self._rows], [len(r.lower) for r in self._rows]
        )

    def point(self, values: Mapping[str, ArrayLike]) -> Array:
        """Return x (N,) of values of all variables by name, each broadcast to its (K, d).

        Raises:
            KeyError: A name is unknown or missing.
        """
        x = self.start
        for name in dict.fromkeys((*self._named, *values)):
            x[self.place(name)] = values[name]
        return x

    def replace_row_bounds(
        self,
        bounds_by_name: Mapping[str, tuple[ArrayLike, ArrayLike]],
        active_masks: Mapping[str, ArrayLike] | None = None,
    ) -> tuple[Array, Array]:
        """Return bounds of the rows (M,) each, with those of some blocks replaced.

        Args:
            bounds_by_name: Bounds by block, each broadcast to (K, m) of its K times m rows.
            active_masks: Masks by block of active rows; the others are open.

        Raises:
            KeyError: A block is unknown.
        """
        lower, upper = self.row_bounds
        for name, (low, high) in bounds_by_name.items():
            rows = self.block(name)
            lower[rows], upper[rows] = low, high
        for name, mask in (active_masks or {}).items():
            rows = self.block(name)
            loose = rows[~np.broadcast_to(np.asarray(mask, bool), rows.shape)]
            lower[loose], upper[loose] = -np.inf, np.inf
        return lower, upper

    @property
    def names(self) -> RowNames:
        """Names of the blocks, and the block of each row."""
        units: dict[str, str] = {}
        for rows in self._rows:
            units.setdefault(rows.name, rows.unit)
        number = {name: k for k, name in enumerate(units)}
        counts = [len(rows.lower) for rows in self._rows]
        block = np.repeat([number[rows.name] for rows in self._rows], counts).astype(np.int32)
        return RowNames(tuple(units), tuple(units.values()), block)

    def residuals(
        self, rows: Array, bounds: tuple[Array, Array] | None = None
    ) -> tuple[BlockResidual, ...]:
        """Return the worst violation of every block at values of the rows (M,).

        `bounds` replaces the stated bounds of the rows.
        """
        lower, upper = self.row_bounds if bounds is None else bounds
        violation = np.where(np.isnan(rows), np.inf, compute_violation(rows, lower, upper))
        return self.names.residuals(violation)

    def program(
        self,
        row_bounds: tuple[Array, Array] | None = None,
        bounds: tuple[Array, Array] | None = None,
    ) -> Program:
        """Return the same program in scalars, for methods other than IPOPT.

        Rows that are affine in the variables are stated as such, the others as smooth ones, and
        binaries as binaries. Costs have to be quadratic. Starts are `guess`.

        Args:
            row_bounds: Bounds of the rows (M,) each, by default the stated ones.
            bounds: Bounds of the variables (N,) each, by default the stated ones.
        """
        program = Program(self.name)
        x, p = [], []
        ends = np.cumsum([len(start) for start in self._start])[:-1]
        sides = (np.split(side, ends) for side in bounds or self.bounds)
        for name, low, high, binary in zip(self._x, *sides, self._binary, strict=True):
            if binary:
                x.append(program.binary(name, low.shape))
            else:
                x.append(program.continuous(name, low.shape, low, high))
        for name, symbol in self._p.items():
            p.append(program.parameter(name, symbol.shape).ravel(order="F"))
        function = ca.Function(
            "stated", [self.x, self.p], [self.rows, ca.vertcat(*self._costs.values())]
        )
        if self._symbols is ca.MX:
            function = function.expand()
        columns = [
            ca.vertcat(*np.concatenate(arrays)) if arrays else ca.SX(0, 1) for arrays in (x, p)
        ]
        rows, costs = (ca.densify(out) for out in function(*columns))
        curved = np.array(ca.which_depends(rows, columns[0], 2, True), bool)
        entries = np.array(rows.elements(), dtype=object)
        lower, upper = self.row_bounds if row_bounds is None else row_bounds
        named = self.names
        for number, (name, unit) in enumerate(zip(named.names, named.units, strict=True)):
            for state, kind in ((program.between, ~curved), (program.smooth, curved)):
                selected = np.flatnonzero((named.block == number) & kind)
                if len(selected):
                    state(name, entries[selected], lower[selected], upper[selected], unit)
        for name, term in zip(self._costs, costs.elements(), strict=True):
            program.minimise(name, term)
        return program
