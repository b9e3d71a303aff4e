"""What a program's own equalities say before any step is taken: compiled, dense, for small ones.

`settled` passes over the rows until no more variables are fixed: a row with one free variable left
is a bound of it (or, as a square, its value), products with a fixed factor are linear. `eliminated`
solves linear equalities for some of their variables by Gauss-Jordan elimination. `thin_product`
multiplies where the left matrix is mostly zeros, without waking the threads of a BLAS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

from climbplan.arrays import Array, IntArray

CONTRADICTION = 1e-9  # rows without variables may fail by this much, relative to their numbers
_NOTHING = 1e-11  # coefficients below are rounding
_PIVOT = 1e-8
_PASSES = 12
_ROOM = 1.25  # bounds of a variable in units of its reach in a sum of squares

Function = TypeVar("Function", bound=Callable[..., object])


def _compiled(function: Function) -> Function:
    options: dict[str, Any] = {"cache": True, "error_model": "numpy"}
    return cast("Function", numba.njit(**options)(function))


@_compiled
def _root(a: float, b: float, c: float, low: float, high: float, size: float) -> float:
    """The only root of a x^2 + b x + c in [low, high], infinite for two, NaN for none."""
    inside = b * b - 4.0 * a * c
    if inside < 0.0:
        if inside < -CONTRADICTION * size * abs(a):
            return np.nan
        inside = 0.0
    apart = np.sqrt(inside)
    found = np.nan
    for sign in (-1.0, 1.0):
        root = (-b + sign * apart) / (2.0 * a)
        slack = CONTRADICTION * (1.0 + abs(root))
        if low - slack <= root <= high + slack:
            if not np.isnan(found) and abs(found - root) > slack:
                return np.inf
            found = min(max(root, low), high)
    return found


@_compiled
def settled(
    A: Array,
    Q: Array,
    first: IntArray,
    second: IntArray,
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
            square, squared = 0.0, -1
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
                    elif p == q and squared in (-1, p):
                        square += a
                        squared = p
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
            if abs(square) > _NOTHING:
                alone = count == 0 or (count == 1 and at == squared)
                if alone and row_lower[i] == row_upper[i]:
                    linear = coefficient[squared]
                    value = _root(
                        square, linear, constant - row_lower[i], low[squared], high[squared], size
                    )
                    if np.isnan(value):
                        return False
                    if np.isfinite(value):
                        low[squared], high[squared] = value, value
                        changed = True
                        done[i] = True
                continue
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
    _within_ellipsoids(A, Q, first, second, row_upper, low, high)
    return True


@_compiled
def _within_ellipsoids(
    A: Array, Q: Array, first: IntArray, second: IntArray, row_upper: Array, low: Array, high: Array
) -> None:
    """Give the variables of rows that are positive sums of squares bounds a little beyond the rows.

    Steps need the scale. A bound that only touches the row is opened: where both are active no
    linearisation can turn the corner (a unit normal could not cross an axis).
    """
    m, n = A.shape
    K = Q.shape[1]
    for i in range(m):
        if not np.isfinite(row_upper[i]):
            continue
        squares = row_upper[i] > 0.0
        for j in range(n):
            squares = squares and (A[i, j] == 0.0 or low[j] == high[j] == 0.0)
        for k in range(K):
            squares = squares and (Q[i, k] == 0.0 or (Q[i, k] > 0.0 and first[k] == second[k]))
        if not squares:
            continue
        for k in range(K):
            j = first[k]
            if Q[i, k] > 0.0 and low[j] < high[j]:
                reach = np.sqrt(row_upper[i] / Q[i, k])
                if high[j] >= reach * (1.0 - CONTRADICTION) and low[j] <= reach:
                    high[j] = _ROOM * reach
                if low[j] <= -reach * (1.0 - CONTRADICTION) and high[j] >= -reach:
                    low[j] = -_ROOM * reach


@_compiled
def eliminated(E: Array, e: Array, preference: Array, pivot: IntArray) -> bool:
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


@_compiled
def thin_product(left: Array, right: Array) -> Array:
    """left @ right, (m, n) by (n, r), skipping zeros of left."""
    m, n = left.shape
    r = right.shape[1]
    out = np.zeros((m, r))
    for i in range(m):
        for j in range(n):
            a = left[i, j]
            if a != 0.0:
                for k in range(r):
                    out[i, k] += a * right[j, k]
    return out
