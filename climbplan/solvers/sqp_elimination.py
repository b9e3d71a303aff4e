"""What a program's own equalities say before any step is taken: compiled, dense, for small ones.

`settled` passes over the rows until no more variables are fixed: a row with one free variable left
is a bound of it, products with a fixed factor are linear. `eliminated` solves linear equalities for
some of their variables by Gauss-Jordan elimination.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

from climbplan.program.instance import Index
from climbplan.program.polytope import Array

CONTRADICTION = 1e-9  # rows without variables may fail by this much, relative to their numbers
_NOTHING = 1e-11  # coefficients below are rounding
_PIVOT = 1e-8
_PASSES = 12

Function = TypeVar("Function", bound=Callable[..., object])


def _compiled(function: Function) -> Function:
    options: dict[str, Any] = {"cache": True, "error_model": "numpy"}
    return cast(Function, numba.njit(**options)(function))


@_compiled
def settled(
    A: Array,
    Q: Array,
    first: Index,
    second: Index,
    row_lower: Array,
    row_upper: Array,
    low: Array,
    high: Array,
) -> bool:
    """Fix and bound variables, in place in low and high (n,); False if rows contradict.

    Rows are row_lower <= A x + Q w <= row_upper with w = x[first] x[second].
    """
    m, n = A.shape
    K = Q.shape[1]
    coefficient = np.zeros(n)
    done = np.zeros(m, np.bool_)
    for j in range(n):
        if low[j] > high[j]:
            if low[j] - high[j] > CONTRADICTION * (1.0 + abs(low[j])):
                return False
            low[j] = high[j]
    for _ in range(_PASSES):
        changed = False
        for i in range(m):
            if done[i]:
                continue
            constant, size = 0.0, 1.0
            open_product = False
            for j in range(n):
                coefficient[j] = 0.0
                a = A[i, j]
                if a != 0.0:
                    if low[j] == high[j]:
                        constant += a * low[j]
                        size += abs(a * low[j])
                    else:
                        coefficient[j] = a
            for k in range(K):
                a = Q[i, k]
                if a != 0.0:
                    p, q = first[k], second[k]
                    if low[p] == high[p]:
                        if low[q] == high[q]:
                            constant += a * low[p] * low[q]
                            size += abs(a * low[p] * low[q])
                        else:
                            coefficient[q] += a * low[p]
                    elif low[q] == high[q]:
                        coefficient[p] += a * low[q]
                    else:
                        open_product = True
                        break
            if open_product:
                continue
            count, at = 0, -1
            for j in range(n):
                if abs(coefficient[j]) > _NOTHING:
                    count += 1
                    at = j
            slack = CONTRADICTION * size
            if count == 0:
                if constant < row_lower[i] - slack or constant > row_upper[i] + slack:
                    return False
                done[i] = True
            elif count == 1:
                a = coefficient[at]
                one, other = (row_lower[i] - constant) / a, (row_upper[i] - constant) / a
                if a < 0:
                    one, other = other, one
                slack = slack / abs(a) + CONTRADICTION * (1.0 + min(abs(one), abs(other)))
                if row_lower[i] == row_upper[i]:
                    if one < low[at] - slack or one > high[at] + slack:
                        return False
                    value = min(max(one, low[at]), high[at])
                    low[at], high[at] = value, value
                    changed = True
                else:
                    if one > high[at] + slack or other < low[at] - slack:
                        return False
                    low[at] = min(max(low[at], one), high[at])
                    high[at] = max(min(high[at], other), low[at])
                    changed = changed or low[at] == high[at]
                done[i] = True
        if not changed:
            break
    return True


@_compiled
def eliminated(E: Array, e: Array, preference: Array, pivot: Index) -> bool:
    """Solve E x = e for one variable a row, in place: E[i, pivot[i]] = 1 and 0 in other rows.

    preference: (n,) of variables as pivots, 0 for never. Rows that say nothing new get pivot -1.
    False if rows contradict.
    """
    r, n = E.shape
    for i in range(r):
        largest, chosen, at = 0.0, 0.0, -1
        for j in range(n):
            size = abs(E[i, j])
            largest = max(largest, size)
            if size * preference[j] > chosen:
                chosen, at = size * preference[j], j
        pivot[i] = -1
        if at < 0 or abs(E[i, at]) <= _PIVOT:
            if largest <= _PIVOT and abs(e[i]) > 1e-7:
                return False
            continue
        pivot[i] = at
        scale = 1.0 / E[i, at]
        for j in range(n):
            E[i, j] *= scale
        e[i] *= scale
        E[i, at] = 1.0
        for k in range(r):
            if k != i and E[k, at] != 0.0:
                factor = E[k, at]
                for j in range(n):
                    E[k, j] -= factor * E[i, j]
                e[k] -= factor * e[i]
                E[k, at] = 0.0
    return True
