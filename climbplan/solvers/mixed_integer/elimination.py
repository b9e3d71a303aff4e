"""Eliminate linear equations: x = center + X w with the independent variables w.

The equations of motion determine states from inputs, forces and integers. Gauss-Jordan elimination
takes the entry of largest magnitude of each equation as pivot. Continuous variables are preferred
to integers, so that integers remain independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_NOTHING = 1e-10  # largest entry of an equation that says nothing more, relative to its own size
_INTEGER = 1e-3  # weight of integers as pivots
_OFF = 1e-7  # residual of an equation without variables that proves a contradiction


@dataclass(frozen=True)
class Elimination:
    """General solution x = center + X w of a system of equations."""

    X: Array  # (n, k)
    center: Array  # (n,)
    independent: IntArray  # (k,) which variables w are
    consistent: bool


@compiled
def reduce_gauss_jordan(E: Array, weight: Array, pivots: IntArray) -> float:
    """Reduce the table (p, n + 1) in place; pivot of each equation, -1 where it is redundant.

    Returns:
        Largest absolute right side of an equation that has no variables left.
    """
    p, n = E.shape[0], E.shape[1] - 1
    worst = 0.0
    for i in range(p):
        pivot_row = E[i]
        best_score, pivot, size = 0.0, -1, 0.0
        for j in range(n):
            a = abs(pivot_row[j])
            if a * weight[j] > best_score:
                best_score, pivot = a * weight[j], j
            size = max(size, a)
        if pivot < 0 or size < _NOTHING:
            pivots[i] = -1
            worst = max(worst, abs(pivot_row[n]))
            continue
        pivots[i] = pivot
        scale = pivot_row[pivot]
        for j in range(n + 1):
            pivot_row[j] /= scale
        for r in range(p):
            factor = E[r, pivot]
            if r == i or factor == 0.0:
                continue
            row = E[r]
            for j in range(n + 1):
                row[j] -= factor * pivot_row[j]
            row[pivot] = 0.0
            for j in range(n):
                if abs(row[j]) < 1e-14:
                    row[j] = 0.0
    return worst


def eliminate_equations(E: Array, e: Array, integer: BoolArray) -> Elimination:
    """Solve E x = e, with E of shape (p, n), for one variable of each independent equation."""
    n = E.shape[1]
    size = np.maximum(np.abs(E).max(axis=1, initial=0.0), 1e-300)[:, None]
    table = np.hstack([E, e[:, None]]) / size
    pivots = np.empty(len(E), np.int64)
    residual = reduce_gauss_jordan(table, np.where(integer, _INTEGER, 1.0), pivots)
    has_pivot = pivots >= 0
    dependent = pivots[has_pivot]
    is_independent = np.ones(n, bool)
    is_independent[dependent] = False
    independent = np.flatnonzero(is_independent)
    X, center = np.zeros((n, len(independent))), np.zeros(n)
    X[independent, np.arange(len(independent))] = 1.0
    X[dependent] = -table[np.ix_(has_pivot, np.append(is_independent, False))]
    center[dependent] = table[has_pivot, n]
    return Elimination(X, center, independent, residual <= _OFF)
