"""Coefficients of stacked expressions: A x + Q w + constants, with w products of two variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.program.polytope import Array

Pairs = list[tuple[int, int]]  # (i, j) with i <= j: the product x_i x_j


@dataclass(frozen=True)
class Affine:
    """Coefficients of stacked affine expressions as functions of theta."""

    function: Any  # theta -> (nonzeros of the Jacobian, constants)
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    rows: int
    columns: int

    def at(self, theta: Array) -> tuple[sparse.csr_matrix, Array]:
        """Matrix (rows, n) and constants (rows,)."""
        values, constants = self.function(theta)
        # CasADi stores columns; its transpose read as compressed rows is the matrix itself.
        matrix = sparse.csr_matrix(
            (np.array(values).ravel(), self.indices, self.indptr), shape=(self.rows, self.columns)
        )
        return matrix, np.array(constants).ravel()


@dataclass(frozen=True)
class Bilinear:
    """Affine coefficients and those of products, as functions of theta."""

    affine: Affine
    product_function: Any  # theta -> coefficients of the product terms
    product_row: NDArray[np.int64]
    product_pair: Pairs  # of each product term

    def products_at(self, theta: Array, position: dict[tuple[int, int], int]) -> sparse.csr_matrix:
        """Matrix (rows, K) over the products numbered by `position`."""
        shape = (self.affine.rows, len(position))
        if not self.product_pair:
            return sparse.csr_matrix(shape)
        values = np.array(self.product_function(theta)).ravel()
        column = [position[pair] for pair in self.product_pair]
        return sparse.csr_matrix((values, (self.product_row, column)), shape=shape)


def affine_coefficients(
    name: str, expression: Sequence[Any], x_symbols: Sequence[Any], theta_symbols: Sequence[Any]
) -> Affine:
    """Raises ValueError if an expression is not affine in the variables."""
    bilinear = bilinear_coefficients(name, expression, x_symbols, theta_symbols)
    if bilinear.product_pair:
        raise ValueError(f"{name} is not affine in the variables")
    return bilinear.affine


def bilinear_coefficients(
    name: str, expression: Sequence[Any], x_symbols: Sequence[Any], theta_symbols: Sequence[Any]
) -> Bilinear:
    """Raises ValueError if an expression is more than quadratic in the variables."""
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
        at, other = (np.array(index) for index in second.sparsity().get_triplet())
        for k in range(len(curvature)):
            i, j = int(indices[at[k]]), int(other[k])
            if i <= j:  # the entry (j, i) is the same product again
                row.append(int(row_of[at[k]]))
                pairs.append((i, j))
                coefficients.append(curvature[k] / 2 if i == j else curvature[k])
    linear = ca.substitute(slopes, x, zero)
    constants = ca.substitute(stacked, x, zero)
    affine = Affine(
        ca.Function("affine", [theta], [linear, constants]),
        indptr,
        indices,
        len(expression),
        len(x_symbols),
    )
    product = ca.Function("products", [theta], [ca.vertcat(*coefficients)])
    return Bilinear(affine, product, np.array(row, np.int64), pairs)
