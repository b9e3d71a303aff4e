"""Equations eliminated: x = center + X w with the independent variables w.

Dynamics make states follow from inputs, forces and integers. Each equation gives away its variable
of largest coefficient, continuous ones before integers, so that what is stated last in time is
solved for first and entries stay as they are.
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
    """x = center + X w."""

    X: Array  # (n, k)
    center: Array  # (n,)
    independent: IntArray  # (k,) which variables w are
    consistent: bool


@compiled
def reduce(E: Array, weight: Array, pivots: IntArray) -> float:
    """Gauss-Jordan on (p, n + 1) in place; pivot of each equation, -1 where it says nothing.

    Returns the largest right side of an equation without variables.
    """
    p, n = E.shape[0], E.shape[1] - 1
    worst = 0.0
    for i in range(p):
        line = E[i]
        best, chosen, size = 0.0, -1, 0.0
        for j in range(n):
            a = abs(line[j])
            if a * weight[j] > best:
                best, chosen = a * weight[j], j
            size = max(size, a)
        if chosen < 0 or size < _NOTHING:
            pivots[i] = -1
            worst = max(worst, abs(line[n]))
            continue
        pivots[i] = chosen
        scale = line[chosen]
        for j in range(n + 1):
            line[j] /= scale
        for r in range(p):
            factor = E[r, chosen]
            if r == i or factor == 0.0:
                continue
            other = E[r]
            for j in range(n + 1):
                other[j] -= factor * line[j]
            other[chosen] = 0.0
            for j in range(n):
                if abs(other[j]) < 1e-14:
                    other[j] = 0.0
    return worst


def eliminated(E: Array, e: Array, integer: BoolArray) -> Elimination:
    """E x = e (p, n) solved for p of the variables."""
    n = E.shape[1]
    size = np.maximum(np.abs(E).max(axis=1, initial=0.0), 1e-300)[:, None]
    table = np.hstack([E, e[:, None]]) / size
    pivots = np.empty(len(E), np.int64)
    worst = reduce(table, np.where(integer, _INTEGER, 1.0), pivots)
    solved = pivots >= 0
    dependent = pivots[solved]
    kept = np.ones(n, bool)
    kept[dependent] = False
    independent = np.flatnonzero(kept)
    X, center = np.zeros((n, len(independent))), np.zeros(n)
    X[independent, np.arange(len(independent))] = 1.0
    X[dependent] = -table[np.ix_(solved, np.append(kept, False))]
    center[dependent] = table[solved, n]
    return Elimination(X, center, independent, worst <= _OFF)
