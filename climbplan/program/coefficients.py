"""Coefficients of stacked expressions: A x + Q w + constants, with w products of two variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.affine_array import AffineArray

Pairs = list[tuple[int, int]]  # (i, j) with i <= j: the product x_i x_j


@dataclass(frozen=True)
class Affine:
    """Coefficients of stacked affine expressions as functions of theta."""

    slopes: Any  # theta -> nonzeros of the Jacobian
    offsets: Any  # theta -> constants
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    rows: int
    columns: int
    matrix: sparse.csr_matrix | None = None  # if the slopes do not depend on parameters

    def at(self, theta: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return the matrix (rows, n) and constants (rows,); a cached matrix stays one object."""
        matrix = self._compute_matrix(theta) if self.matrix is None else self.matrix
        return matrix, np.array(self.offsets(theta)).ravel()

    def cache_matrix(self, theta: Array) -> Affine:
        """Return the same with its matrix computed once, for slopes that do not depend on theta."""
        return replace(self, matrix=self._compute_matrix(theta))

    def _compute_matrix(self, theta: Array) -> sparse.csr_matrix:
        # CasADi stores columns; its transpose read as compressed rows is the matrix itself.
        """Compute the matrix at theta."""
        values = np.array(self.slopes(theta)).ravel()
        return sparse.csr_matrix(
            (values, self.indices, self.indptr), shape=(self.rows, self.columns)
        )


@dataclass(frozen=True)
class FixedAffine:
    """Coefficients that do not depend on parameters."""

    matrix: sparse.csr_matrix  # (rows, n)
    constants: Array  # (rows,)

    @classmethod
    def of(cls, expression: AffineArray, columns: int) -> FixedAffine:
        """Build from an expression; `columns` is n, with variables that were stated later."""
        M = expression.coefficients
        wide = sparse.csr_matrix((M.data, M.indices, M.indptr), shape=(M.shape[0], columns))
        return cls(wide, expression.constants)

    @property
    def columns(self) -> int:
        """Number of variables n."""
        return int(self.matrix.shape[1])

    def at(self, theta: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return the matrix (rows, n) and constants (rows,) for any theta."""
        return self.matrix, self.constants


@dataclass(frozen=True)
class JoinedAffine:
    """Rows of several kinds, in the order of statement."""

    parts: tuple[Affine | FixedAffine, ...]
    order: IntArray  # for each row its index among the concatenated rows of the parts
    columns: int
    _last: list[Any] = field(default_factory=list)  # matrices of the parts and their stack

    def at(self, theta: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return the matrix (rows, n), one object while those of its parts are, and constants."""
        coefficients = [coefficient_part.at(theta) for coefficient_part in self.parts]
        matrices = [m for m, _ in coefficients]
        is_unchanged = self._last and all(
            a is b for a, b in zip(matrices, self._last[0], strict=True)
        )
        if not is_unchanged:
            self._last[:] = [matrices, sparse.vstack(matrices).tocsr()[self.order]]
        return self._last[1], np.concatenate([c for _, c in coefficients])[self.order]


@dataclass(frozen=True)
class Bilinear:
    """Affine coefficients and those of products, as functions of theta."""

    affine: Affine | JoinedAffine
    product_function: Any  # theta -> coefficients of the product terms
    product_row: IntArray
    product_pair: Pairs  # of each product term
    rows: int

    def compute_products(
        self, theta: Array, position: dict[tuple[int, int], int]
    ) -> sparse.csr_matrix:
        """Return the matrix (rows, K) over the products numbered by `position`."""
        shape = (self.rows, len(position))
        if not self.product_pair:
            return _empty_matrix(*shape)
        values = np.array(self.product_function(theta)).ravel()
        column = [position[pair] for pair in self.product_pair]
        return sparse.csr_matrix((values, (self.product_row, column)), shape=shape)


@lru_cache(maxsize=64)
def _empty_matrix(rows: int, columns: int) -> sparse.csr_matrix:
    """Return a matrix without entries."""
    return sparse.csr_matrix((rows, columns))


def depends_on_parameters(theta: Any, numbers: Any) -> bool:
    """Return whether numbers, which need not be symbols, depend on parameters."""
    return isinstance(numbers, ca.SX) and bool(ca.depends_on(numbers, theta))


def extract_affine(
    name: str,
    expression: Sequence[Any] | AffineArray,
    x_symbols: Sequence[Any],
    theta_symbols: Sequence[Any],
) -> Affine | FixedAffine | JoinedAffine:
    """Extract the coefficients of affine expressions.

    Raises:
        ValueError: An expression is not affine in the variables.
    """
    if isinstance(expression, AffineArray):
        return FixedAffine.of(expression, len(x_symbols))
    bilinear = extract_bilinear(name, expression, x_symbols, theta_symbols)
    if bilinear.product_pair:
        raise ValueError(f"{name} is not affine in the variables")
    return bilinear.affine


def extract_joined(
    name: str,
    expressions: Sequence[Sequence[Any] | AffineArray],
    x_symbols: Sequence[Any],
    theta_symbols: Sequence[Any],
) -> Bilinear:
    """Extract coefficients of several blocks, of scalars or with numbers, one after another."""
    stated = [e for block in expressions if not isinstance(block, AffineArray) for e in block]
    bilinear = extract_bilinear(name, stated, x_symbols, theta_symbols)
    fixed = [block for block in expressions if isinstance(block, AffineArray)]
    if not fixed:
        return bilinear
    n = len(x_symbols)
    row, num_scalar, num_fixed = 0, 0, len(stated)
    order: list[IntArray] = []
    row_of_scalar = np.zeros(len(stated), np.int64)  # row of each stated scalar
    for block in expressions:
        rows = row + np.arange(len(block))
        if isinstance(block, AffineArray):
            order.append(num_fixed + np.arange(len(block)))
            num_fixed += len(block)
        else:
            order.append(num_scalar + np.arange(len(block)))
            row_of_scalar[num_scalar : num_scalar + len(block)] = rows
            num_scalar += len(block)
        row += len(block)
    assert not isinstance(bilinear.affine, JoinedAffine)
    coefficient_parts: tuple[Affine | FixedAffine, ...] = (
        bilinear.affine,
        *(FixedAffine.of(block, n) for block in fixed),
    )
    joined = JoinedAffine(coefficient_parts, np.concatenate(order), n)
    product_row = (
        row_of_scalar[bilinear.product_row] if len(bilinear.product_row) else bilinear.product_row
    )
    return Bilinear(joined, bilinear.product_function, product_row, bilinear.product_pair, row)


def extract_bilinear(
    name: str, expression: Sequence[Any], x_symbols: Sequence[Any], theta_symbols: Sequence[Any]
) -> Bilinear:
    """Extract the coefficients of bilinear expressions.

    Raises:
        ValueError: An expression is more than quadratic in the variables.
    """
    x, theta = ca.vertcat(*x_symbols), ca.vertcat(*theta_symbols)
    zero = ca.DM.zeros(x.shape)
    stacked = ca.vertcat(*expression) if expression else ca.SX(0, 1)
    transposed = ca.jacobian(stacked, x).T  # its columns are our rows
    entries: Any = transposed.nonzeros()
    slopes = ca.vertcat(*entries)
    pattern = transposed.sparsity()
    indptr = np.array(pattern.colind(), np.int32)
    indices = np.array(pattern.row(), np.int32)

    row: list[int] = []
    pairs: Pairs = []
    coefficients: list[Any] = []
    if entries and ca.depends_on(slopes, x):
        row_of = np.repeat(np.arange(len(expression)), np.diff(indptr))
        second = ca.jacobian(slopes, x)  # (nonzeros of the Jacobian, n)
        curvature: Any = second.nonzeros()
        if ca.depends_on(ca.vertcat(*curvature), x):
            raise ValueError(f"{name} is not affine or bilinear in the variables")
        slope_index, variable = (np.array(index) for index in second.sparsity().get_triplet())
        for k in range(len(curvature)):
            i, j = int(indices[slope_index[k]]), int(variable[k])
            if i <= j:  # the entry (j, i) is the same product again
                row.append(int(row_of[slope_index[k]]))
                pairs.append((i, j))
                coefficients.append(curvature[k] / 2 if i == j else curvature[k])
    linear = ca.substitute(slopes, x, zero)
    constants = ca.substitute(stacked, x, zero)
    affine = Affine(
        ca.Function("slopes", [theta], [linear]),
        ca.Function("offsets", [theta], [constants]),
        indptr,
        indices,
        len(expression),
        len(x_symbols),
    )
    if not depends_on_parameters(theta, linear):
        affine = affine.cache_matrix(np.zeros(theta.shape[0]))
    product = ca.Function("products", [theta], [ca.vertcat(*coefficients)])
    return Bilinear(affine, product, np.array(row, np.int64), pairs, len(expression))
