"""Coefficients of a stated program, extracted once as functions of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.affine_array import AffineArray, Quadratic
from climbplan.program.blocks import Blocks
from climbplan.program.coefficients import (
    Affine,
    Bilinear,
    FixedAffine,
    JoinedAffine,
    depends_on_parameters,
    extract_affine,
    extract_joined,
)
from climbplan.program.instance import Balls, Choice, Implications, Instance, Products
from climbplan.program.smooth import Smooth, SmoothForm


@dataclass(frozen=True)
class CompiledProgram:
    """All coefficients as functions of theta, with the blocks to which they belong."""

    name: str
    blocks: Blocks
    rows: Bilinear
    implications: Bilinear
    binaries: IntArray  # binary of each implication row
    balls: tuple[Affine | FixedAffine | JoinedAffine, ...]
    limits: tuple[Affine | FixedAffine | JoinedAffine | None, ...]  # of balls with a slope
    choices: tuple[Affine | FixedAffine | JoinedAffine, ...]  # by block; rows of all its points
    products: dict[tuple[int, int], int]  # pair -> number of the product
    cost: Any  # theta -> (q, constant)
    curvature: Any  # theta -> nonzeros of P
    P_indptr: NDArray[np.int32]
    P_indices: NDArray[np.int32]
    numeric: tuple[Quadratic, ...]  # cost terms without parameters
    smooth: SmoothForm | None
    P: sparse.csc_matrix | None = None  # if it does not depend on parameters

    @property
    def product_count(self) -> int:
        """Number of different products of two variables in rows and implications."""
        return len(self.products)

    def instance(self, theta: Array) -> Instance:
        """Return the coefficients at theta."""
        blocks = self.blocks
        A, constants = self.rows.affine.at(theta)
        balls = []
        for ball, affine, limit in zip(blocks.balls, self.balls, self.limits, strict=True):
            F, f = affine.at(theta)
            slope, offset = (None, 0.0) if limit is None else limit.at(theta)
            balls.append(Balls(F, f.reshape(-1, ball.dimension), ball.radius + offset, slope))
        choices = []
        for group, affine in zip(blocks.choices, self.choices, strict=True):
            E, e = affine.at(theta)
            for k, alternatives in enumerate(group.alternatives):
                span = slice(k * group.dimension, (k + 1) * group.dimension)
                choices.append(Choice(f"{group.name}[{k}]", E[span], e[span], alternatives))
        gradient, at_zero = self.cost(theta)
        q, constant = np.array(gradient).ravel(), float(at_zero)
        for term in self.numeric:
            q[: len(term.q)] += term.q
            constant += term.constant
        pairs = np.array(list(self.products), np.int64).reshape(-1, 2)
        integer = [np.full(v.lower.size, v.integer) for v in blocks.variables]
        return Instance(
            name=self.name,
            P=self._compute_curvature(theta) if self.P is None else self.P,
            q=q,
            constant=constant,
            lower=_stack([v.lower for v in blocks.variables]),
            upper=_stack([v.upper for v in blocks.variables]),
            A=A,
            row_lower=_stack([b.lower for b in blocks.rows]) - constants,
            row_upper=_stack([b.upper for b in blocks.rows]) - constants,
            balls=tuple(balls),
            choices=tuple(choices),
            integer=np.concatenate([np.zeros(0, bool), *integer]),
            products=Products(pairs[:, 0], pairs[:, 1]),
            Q=self.rows.compute_products(theta, self.products),
            implications=self._build_implications(theta),
            smooth=self._build_smooth_rows(theta),
        )

    def cache_curvature(self, theta: Array) -> CompiledProgram:
        """Return the same with P computed once; theta is arbitrary, as P does not depend on it."""
        return replace(self, P=self._compute_curvature(theta))

    def _compute_curvature(self, theta: Array) -> sparse.csc_matrix:
        """Compute P at theta."""
        n = self.rows.affine.columns
        values = np.array(self.curvature(theta)).ravel()
        P = sparse.csc_matrix((values, self.P_indices, self.P_indptr), shape=(n, n))
        for term in self.numeric:
            P = P + _widen(term.P, n).tocsc()
        P.sort_indices()
        return P

    def _build_smooth_rows(self, theta: Array) -> Smooth | None:
        """Build the smooth rows at theta."""
        if self.smooth is None:
            return None
        lower = _stack([b.lower for b in self.blocks.smooth])
        return Smooth(self.smooth, theta, lower, _stack([b.upper for b in self.blocks.smooth]))

    def _build_implications(self, theta: Array) -> Implications:
        """Build the implications at theta."""
        A, constants = self.implications.affine.at(theta)
        blocks = self.blocks.implications
        value = [np.full(len(b.expression), b.value) for b in blocks]
        return Implications(
            A=A,
            Q=self.implications.compute_products(theta, self.products),
            lower=_stack([b.lower for b in blocks]) - constants,
            upper=_stack([b.upper for b in blocks]) - constants,
            binary=self.binaries,
            value=np.concatenate([np.zeros(0, bool), *value]),
        )


def _stack(arrays: Sequence[Array]) -> Array:
    """Concatenate flattened arrays."""
    return np.concatenate([np.zeros(0), *(np.ravel(p) for p in arrays)])


def _widen(matrix: sparse.csr_matrix, n: int) -> sparse.csr_matrix:
    """Return the same entries among n variables."""
    extra = np.full(n - matrix.shape[0], matrix.indptr[-1], matrix.indptr.dtype)
    indptr = np.concatenate([matrix.indptr, extra])
    return sparse.csr_matrix((matrix.data, matrix.indices, indptr), shape=(n, n))


def compile_program(
    name: str,
    blocks: Blocks,
    cost: Any,
    numeric: Sequence[Quadratic],
    x_symbols: Sequence[Any],
    theta_symbols: Sequence[Any],
) -> CompiledProgram:
    """Extract the coefficients of a program.

    Args:
        name: Name of the program.
        blocks: Its blocks.
        cost: Cost of scalars.
        numeric: Cost terms with numeric coefficients.
        x_symbols: Variables.
        theta_symbols: Parameters.

    Raises:
        ValueError: Rows or implications are more than bilinear, balls or choices not affine, the
            cost not quadratic, or the condition of an implication is not a single stated binary.
    """
    x, theta = ca.vertcat(*x_symbols), ca.vertcat(*theta_symbols)

    def bilinear(label: str, expressions: Sequence[Sequence[Any] | AffineArray]) -> Bilinear:
        return extract_joined(f"{name}: {label}", expressions, x_symbols, theta_symbols)

    def affine(
        label: str, expression: Sequence[Any] | AffineArray
    ) -> Affine | FixedAffine | JoinedAffine:
        return extract_affine(f"{name}: {label}", expression, x_symbols, theta_symbols)

    rows = bilinear("a row block", [b.expression for b in blocks.rows])
    implications = bilinear("an implication", [b.expression for b in blocks.implications])
    products: dict[tuple[int, int], int] = {}
    for pair in (*rows.product_pair, *implications.product_pair):
        products.setdefault(pair, len(products))
    sparsity, nonzeros, offsets = _differentiate_cost(name, cost, x)
    program = CompiledProgram(
        name=name,
        blocks=blocks,
        rows=rows,
        implications=implications,
        binaries=_find_binaries(name, blocks, x_symbols, theta_symbols),
        balls=tuple(affine(b.name, b.expression) for b in blocks.balls),
        limits=tuple(None if b.slope is None else affine(b.name, b.slope) for b in blocks.balls),
        choices=tuple(affine(b.name, b.expression) for b in blocks.choices),
        products=products,
        cost=ca.Function("cost", [theta], offsets),
        curvature=ca.Function("curvature", [theta], [nonzeros]),
        P_indptr=np.array(sparsity.colind(), np.int32),
        P_indices=np.array(sparsity.row(), np.int32),
        numeric=tuple(numeric),
        smooth=SmoothForm.of(blocks.smooth, x_symbols, theta_symbols),
    )
    return (
        program
        if depends_on_parameters(theta, nonzeros)
        else program.cache_curvature(np.zeros(theta.shape[0]))
    )


def _differentiate_cost(name: str, cost: Any, x: Any) -> tuple[Any, Any, list[Any]]:
    """Return the Hessian's sparsity and nonzeros, and the cost's gradient and value at zero.

    Raises:
        ValueError: The cost is not quadratic.
    """
    hessian, gradient = ca.hessian(cost, x)
    entries: Any = hessian.nonzeros()
    nonzeros = ca.vertcat(*entries)
    if ca.depends_on(nonzeros, x):
        raise ValueError(f"{name}: the cost is not quadratic in the variables")
    zero = ca.DM.zeros(x.shape)
    at_zero = [ca.substitute(gradient, x, zero), ca.substitute(cost, x, zero)]
    return hessian.sparsity(), nonzeros, at_zero


def _find_binaries(
    name: str, blocks: Blocks, x_symbols: Sequence[Any], theta_symbols: Sequence[Any]
) -> IntArray:
    """Return the index of the binary of each implication row."""
    stated = [e for b in blocks.implications for e in b.binary]
    if not stated:
        return np.zeros(0, np.int64)
    matrix, _ = extract_affine(f"{name}: a condition", stated, x_symbols, theta_symbols).at(
        np.zeros(len(theta_symbols))
    )
    integer = np.concatenate([np.full(v.lower.size, v.integer) for v in blocks.variables])
    single = (np.diff(matrix.indptr) == 1).all() and (matrix.data == 1).all()
    if not single or not integer[matrix.indices].all():
        raise ValueError(f"{name}: an implication must hang on one stated binary")
    return np.asarray(matrix.indices, np.int64)
