"""Exact derivatives of a staged program, from those of one knot of each stage.

A stage at K knots has rows r(z_k, p_k) and a cost c(z_k, p_k), where S_k selects the variables
z_k = S_k x of a knot. With the Lagrangian l_k = sigma c + lambda_k . r of a knot,

    gradient  sum_k S_k^T grad c(z_k)
    Jacobian  [J(z_k) S_k]_k
    Hessian   sum_k S_k^T (hess l_k) S_k

so expressions are differentiated once, however many knots there are. CasADi would differentiate the
expanded program knot by knot, which takes K times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.stage import Stage

_PROBE = 0.5  # value of parameters, for which no selection of variables is a whole number


@dataclass(frozen=True)
class StageCall:
    """A stage at K knots, with a matrix (d, K) or (d, 1) for each of its inputs."""

    stage: Stage
    inputs: tuple[Any, ...]
    knots: int


@dataclass(frozen=True)
class ProgramDerivatives:
    """Functions of CasADi that evaluate the derivatives of a program."""

    gradient: ca.Function  # (x, p) -> cost, gradient
    jacobian: ca.Function  # (x, p) -> rows, Jacobian
    hessian: ca.Function  # (x, p, sigma, lambda) -> upper triangle of the Lagrangian's Hessian


def build_stage_derivatives(x: Any, p: Any, calls: Sequence[StageCall]) -> ProgramDerivatives:
    """Build the derivatives of a program whose rows and costs are those of stages.

    Args:
        x: Variables (N,), MX.
        p: Parameters (P,), MX.
        calls: The stages in the order of their rows (M,).

    Raises:
        ValueError: An input of a stage mixes variables, other than by selecting them.
    """
    size, num_rows = x.numel(), sum(call.stage.num_rows * call.knots for call in calls)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", num_rows)
    gradient = _SparseSum((size, 1))
    jacobian, hessian = _SparseSum((num_rows, size)), _SparseSum((size, size))
    cost, rows = ca.MX(0), list[Any]()
    for call in calls:
        m, first_row = call.stage.num_rows, sum(block.numel() for block in rows)
        arguments = [_widen(ca.MX(argument), call.knots) for argument in call.inputs]
        selected = [_find_selected_variables(x, p, argument) for argument in arguments]
        is_variable = [bool((positions >= 0).any()) for positions in selected]
        knot = _KnotDerivatives.build(call.stage, is_variable)
        columns = np.hstack(list(compress(selected, is_variable)))  # (K, Z)

        knot_cost, entries = knot.gradient.map(call.knots)(*arguments)
        cost += ca.sum2(knot_cost)
        gradient.add(entries, columns, np.zeros_like(columns))

        knot_rows, entries = knot.jacobian.map(call.knots)(*arguments)
        rows.append(ca.vec(knot_rows))
        number = first_row + m * np.arange(call.knots)[:, None]
        row, column = knot.jacobian_pattern
        jacobian.add(entries, number + row, columns[:, column])

        weights = ca.reshape(multipliers[first_row : first_row + m * call.knots], m, call.knots)
        entries = knot.hessian.map(call.knots)(*arguments, _widen(sigma, call.knots), weights)
        row, column = knot.hessian_pattern
        hessian.add_symmetric(entries, columns[:, row], columns[:, column], row == column)
    return ProgramDerivatives(
        gradient=ca.Function(
            "nlp_grad_f", [x, p], [cost, gradient.build()], ["x", "p"], ["f", "grad_f_x"]
        ),
        jacobian=ca.Function(
            "nlp_jac_g",
            [x, p],
            [ca.vertcat(*rows), jacobian.build()],
            ["x", "p"],
            ["g", "jac_g_x"],
        ),
        hessian=ca.Function(
            "nlp_hess_l",
            [x, p, sigma, multipliers],
            [hessian.build()],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    )


@dataclass(frozen=True)
class _KnotDerivatives:
    """Derivatives of a stage at one knot in the Z entries of those inputs that are variable.

    The functions take the inputs of the stage and return non-zero entries.
    """

    gradient: ca.Function  # -> cost, (Z,)
    jacobian: ca.Function  # -> rows (m,), entries
    hessian: ca.Function  # with sigma and multipliers (m,) -> entries of the upper triangle
    jacobian_pattern: tuple[IntArray, IntArray]  # row and column of each entry
    hessian_pattern: tuple[IntArray, IntArray]

    @staticmethod
    def build(stage: Stage, is_variable: Sequence[bool]) -> _KnotDerivatives:
        """Differentiate the expressions of a stage in those inputs that are variable."""
        inputs, rows, costs = stage.get_expressions()
        z = ca.vertcat(*compress(inputs, is_variable))
        sigma, multipliers = ca.SX.sym("sigma"), ca.SX.sym("lambda", rows.numel())
        cost = ca.sum1(costs)
        jacobian: Any = ca.jacobian(rows, z)
        hessian: Any = ca.triu(ca.hessian(sigma * cost + ca.dot(multipliers, rows), z)[0])
        name = stage.name
        return _KnotDerivatives(
            gradient=ca.Function(
                f"{name}_gradient", inputs, [cost, ca.densify(ca.gradient(cost, z))]
            ),
            jacobian=ca.Function(
                f"{name}_jacobian", inputs, [rows, ca.vertcat(*jacobian.nonzeros())]
            ),
            hessian=ca.Function(
                f"{name}_hessian",
                [*inputs, sigma, multipliers],
                [ca.vertcat(*hessian.nonzeros())],
            ),
            jacobian_pattern=_get_pattern(jacobian),
            hessian_pattern=_get_pattern(hessian),
        )


def _get_pattern(matrix: Any) -> tuple[IntArray, IntArray]:
    row, column = matrix.sparsity().get_triplet()
    return np.array(row, np.int64), np.array(column, np.int64)


def _widen(argument: Any, knots: int) -> Any:
    return argument if argument.size2() == knots else ca.repmat(argument, 1, knots)


def _find_selected_variables(x: Any, p: Any, argument: Any) -> IntArray:
    """Return the position in x of each entry (K, d) of an argument (d, K); -1 of a parameter."""
    function = ca.Function("selected", [x, p], [ca.vec(argument)])
    positions = np.full(argument.numel(), -1, np.int64)
    row, column = (np.array(v, np.int64) for v in function.jac_sparsity(0, 0).get_triplet())
    positions[row] = column
    values = np.array(function(np.arange(x.numel()), _PROBE)).ravel()
    if len(np.unique(row)) < len(row) or (values[row] != column).any():
        raise ValueError(f"an input of {argument.size1()} rows is no selection of variables")
    return positions.reshape(argument.size2(), -1)


@dataclass
class _SparseSum:
    """A sparse matrix as the sum of entries at given places; those at negative ones are dropped."""

    shape: tuple[int, int]
    _entries: list[Any] = field(default_factory=list)
    _rows: list[IntArray] = field(default_factory=list)
    _columns: list[IntArray] = field(default_factory=list)
    _factors: list[Array] = field(default_factory=list)

    def add(
        self, entries: Any, rows: IntArray, columns: IntArray, factors: Array | None = None
    ) -> None:
        """Add entries (E, K), MX, at rows and columns (K, E), times factors of 1 if None."""
        self._entries.append(ca.vec(entries))
        self._rows.append(rows.ravel())
        self._columns.append(columns.ravel())
        self._factors.append(np.ones(rows.size) if factors is None else factors.ravel())

    def add_symmetric(
        self, entries: Any, rows: IntArray, columns: IntArray, is_diagonal: BoolArray
    ) -> None:
        """Add the upper triangles of symmetric matrices to that of the sum.

        is_diagonal: (E,). Other entries that are of one variable here stand for two equal ones.
        """
        low, high = np.minimum(rows, columns), np.maximum(rows, columns)
        self.add(entries, low, high, np.where((rows == columns) & ~is_diagonal, 2.0, 1.0))

    def build(self) -> Any:
        """Return the sum, MX."""
        row, column = np.concatenate(self._rows), np.concatenate(self._columns)
        kept_entries = np.flatnonzero((row >= 0) & (column >= 0))
        place, target = np.unique(
            column[kept_entries] * self.shape[0] + row[kept_entries], return_inverse=True
        )  # column by column, as CasADi has them
        start = np.searchsorted(place // self.shape[0], np.arange(self.shape[1] + 1))
        sparsity = ca.Sparsity(*self.shape, start.tolist(), (place % self.shape[0]).tolist())
        factors = np.concatenate(self._factors)[kept_entries]
        scatter = sp.csc_matrix((factors, (target, kept_entries)), shape=(len(place), len(row)))
        return ca.MX(sparsity, ca.mtimes(ca.DM(scatter), ca.vertcat(*self._entries)))
