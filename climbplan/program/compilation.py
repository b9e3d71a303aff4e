"""Coefficients of a stated program, extracted once as functions of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.program.blocks import BallBlock, ChoiceBlock, RowBlock, Variable
from climbplan.program.instance import Balls, Choice, Instance
from climbplan.program.polytope import Array


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
class CompiledProgram:
    """All coefficients as functions of theta, with the blocks they belong to."""

    name: str
    variables: Sequence[Variable]
    row_blocks: Sequence[RowBlock]
    ball_blocks: Sequence[BallBlock]
    choice_blocks: Sequence[ChoiceBlock]
    rows: Affine
    balls: tuple[Affine, ...]
    choices: tuple[Affine, ...]  # one a block; rows of all its points
    cost: Any  # theta -> (P nonzeros, q, constant)
    P_indptr: NDArray[np.int32]
    P_indices: NDArray[np.int32]

    def instance(self, theta: Array) -> Instance:
        """The numbers at theta."""
        n = self.rows.columns
        A, constants = self.rows.at(theta)
        balls = []
        for ball, affine in zip(self.ball_blocks, self.balls, strict=True):
            F, f = affine.at(theta)
            balls.append(Balls(F, f.reshape(-1, ball.dimension), ball.radius))
        choices = []
        for group, affine in zip(self.choice_blocks, self.choices, strict=True):
            E, e = affine.at(theta)
            for k, alternatives in enumerate(group.alternatives):
                here = slice(k * group.dimension, (k + 1) * group.dimension)
                choices.append(Choice(f"{group.name}[{k}]", E[here], e[here], alternatives))
        values, q, constant = self.cost(theta)
        P = sparse.csc_matrix(
            (np.array(values).ravel(), self.P_indices, self.P_indptr), shape=(n, n)
        )
        P.sort_indices()
        return Instance(
            name=self.name,
            P=P,
            q=np.array(q).ravel(),
            constant=float(constant),
            lower=_stack([v.lower for v in self.variables]),
            upper=_stack([v.upper for v in self.variables]),
            A=A,
            row_lower=_stack([b.lower for b in self.row_blocks]) - constants,
            row_upper=_stack([b.upper for b in self.row_blocks]) - constants,
            balls=tuple(balls),
            choices=tuple(choices),
        )


def _stack(parts: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *(np.ravel(p) for p in parts)])


def compile_program(
    name: str,
    variables: Sequence[Variable],
    row_blocks: Sequence[RowBlock],
    ball_blocks: Sequence[BallBlock],
    choice_blocks: Sequence[ChoiceBlock],
    cost: Any,
    x_symbols: Any,
    theta_symbols: Any,
) -> CompiledProgram:
    """Extract coefficients; ValueError if a block is not affine or the cost not quadratic."""
    x, theta = ca.vertcat(*x_symbols), ca.vertcat(*theta_symbols)
    zero = ca.DM.zeros(x.shape)

    def affine(block: str, expression: Any) -> Affine:
        stacked = ca.vertcat(*expression) if expression else ca.SX(0, 1)
        transposed = ca.jacobian(stacked, x).T  # its columns are our rows
        coefficients: Any = transposed.nonzeros()
        values = ca.vertcat(*coefficients)
        if ca.depends_on(values, x):
            raise ValueError(f"{name}: {block} is not affine in the variables")
        constants = ca.substitute(stacked, x, zero)
        pattern = transposed.sparsity()
        return Affine(
            ca.Function("affine", [theta], [values, constants]),
            np.array(pattern.colind(), np.int32),
            np.array(pattern.row(), np.int32),
            len(expression),
            len(x_symbols),
        )

    hessian, gradient = ca.hessian(cost, x)
    entries: Any = hessian.nonzeros()
    nonzeros = ca.vertcat(*entries)
    if ca.depends_on(nonzeros, x):
        raise ValueError(f"{name}: the cost is not quadratic in the variables")
    offsets = [ca.substitute(gradient, x, zero), ca.substitute(cost, x, zero)]
    return CompiledProgram(
        name,
        variables,
        row_blocks,
        ball_blocks,
        choice_blocks,
        rows=affine("a linear block", [e for block in row_blocks for e in block.expression]),
        balls=tuple(affine(b.name, b.expression) for b in ball_blocks),
        choices=tuple(affine(b.name, b.expression) for b in choice_blocks),
        cost=ca.Function("cost", [theta], [nonzeros, *offsets]),
        P_indptr=np.array(hessian.sparsity().colind(), np.int32),
        P_indices=np.array(hessian.sparsity().row(), np.int32),
    )
