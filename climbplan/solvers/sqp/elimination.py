"""Presolve of small dense programs in compiled code: fixed variables and linear equations.

`propagate_fixed` passes over the rows until no more variables are fixed. A row with one free
variable is a bound of it (or, as a square, its value), and products with a fixed factor are linear.
`eliminate_equations` solves linear equations for some of their variables by Gauss-Jordan
elimination. `multiply_sparse` multiplies where the left matrix is mostly zeros, without the threads
of a BLAS.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.compiling import create_compiler

CONTRADICTION = 1e-9  # tolerance of rows without variables, relative to their entries
_NOTHING = 1e-11  # coefficients below this are rounding errors
_PIVOT = 1e-8
_PASSES = 12
_ELLIPSOID_MARGIN = 1.25  # bounds of a variable in units of its reach in a sum of squares

compiled = create_compiler(Path(__file__).parent, "elimination.py")


@compiled
def _find_root(a: float, b: float, c: float, low: float, high: float, size: float) -> float:
    """Return the only root of a x^2 + b x + c in [low, high], infinity for two, NaN for none."""
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        if discriminant < -CONTRADICTION * size * abs(a):
            return np.nan
        discriminant = 0.0
    root_of_discriminant = np.sqrt(discriminant)
    unique_root = np.nan
    for sign in (-1.0, 1.0):
        root = (-b + sign * root_of_discriminant) / (2.0 * a)
        slack = CONTRADICTION * (1.0 + abs(root))
        if low - slack <= root <= high + slack:
            if not np.isnan(unique_root) and abs(unique_root - root) > slack:
                return np.inf
            unique_root = min(max(root, low), high)
    return unique_root


@compiled
def propagate_fixed(
    A: Array,
    Q: Array,
    first: IntArray,
    second: IntArray,
    row_lower: Array,
    row_upper: Array,
    low: Array,
    high: Array,
) -> bool:
    """Fix and bound variables, in place in low and high (n,); return False if rows contradict.

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
            constant, magnitude = 0.0, 1.0
            open_product = False
            square, squared = 0.0, -1
            for j in range(n):
                coefficient[j] = 0.0
                a = A[i, j]
                if a != 0.0:
                    if low[j] == high[j]:
                        constant += a * low[j]
                        magnitude += abs(a * low[j])
                    else:
                        coefficient[j] = a
            for k in range(K):
                a = Q[i, k]
                if a != 0.0:
                    p, q = first[k], second[k]
                    if low[p] == high[p]:
                        if low[q] == high[q]:
                            constant += a * low[p] * low[q]
                            magnitude += abs(a * low[p] * low[q])
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
            count, variable = 0, -1
            for j in range(n):
                if abs(coefficient[j]) > _NOTHING:
                    count += 1
                    variable = j
            slack = CONTRADICTION * magnitude
            if abs(square) > _NOTHING:
                is_univariate = count == 0 or (count == 1 and variable == squared)
                if is_univariate and row_lower[i] == row_upper[i]:
                    linear = coefficient[squared]
                    value = _find_root(
                        square,
                        linear,
                        constant - row_lower[i],
                        low[squared],
                        high[squared],
                        magnitude,
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
                a = coefficient[variable]
                bound_low, bound_high = (row_lower[i] - constant) / a, (row_upper[i] - constant) / a
                if a < 0:
                    bound_low, bound_high = bound_high, bound_low
                slack = slack / abs(a) + CONTRADICTION * (
                    1.0 + min(abs(bound_low), abs(bound_high))
                )
                if row_lower[i] == row_upper[i]:
                    if bound_low < low[variable] - slack or bound_low > high[variable] + slack:
                        return False
                    value = min(max(bound_low, low[variable]), high[variable])
                    low[variable], high[variable] = value, value
                    changed = True
                else:
                    if bound_low > high[variable] + slack or bound_high < low[variable] - slack:
                        return False
                    low[variable] = min(max(low[variable], bound_low), high[variable])
                    high[variable] = max(min(high[variable], bound_high), low[variable])
                    changed = changed or low[variable] == high[variable]
                done[i] = True
        if not changed:
            break
    _bound_ellipsoids(A, Q, first, second, row_upper, low, high)
    return True


@compiled
def _bound_ellipsoids(
    A: Array, Q: Array, first: IntArray, second: IntArray, row_upper: Array, low: Array, high: Array
) -> None:
    """Bound the variables of rows that are positive sums of squares a little beyond the rows.

    Steps need the scale. A bound that only touches the row is relaxed: where both are active, no
    linearisation can pass the corner (a unit normal could not cross an axis).
    """
    m, n = A.shape
    K = Q.shape[1]
    for i in range(m):
        if not np.isfinite(row_upper[i]):
            continue
        is_sum_of_squares = row_upper[i] > 0.0
        for j in range(n):
            is_sum_of_squares = is_sum_of_squares and (A[i, j] == 0.0 or low[j] == high[j] == 0.0)
        for k in range(K):
            is_sum_of_squares = is_sum_of_squares and (
                Q[i, k] == 0.0 or (Q[i, k] > 0.0 and first[k] == second[k])
            )
        if not is_sum_of_squares:
            continue
        for k in range(K):
            j = first[k]
            if Q[i, k] > 0.0 and low[j] < high[j]:
                reach = np.sqrt(row_upper[i] / Q[i, k])
                if high[j] >= reach * (1.0 - CONTRADICTION) and low[j] <= reach:
                    high[j] = _ELLIPSOID_MARGIN * reach
                if low[j] <= -reach * (1.0 - CONTRADICTION) and high[j] >= -reach:
                    low[j] = -_ELLIPSOID_MARGIN * reach


@compiled
def eliminate_equations(E: Array, e: Array, preference: Array, pivot: IntArray) -> bool:
    """Solve E x = e for one variable of each row, in place: E[i, pivot[i]] = 1 and 0 in other rows.

    Args:
        E: (r, n) coefficients.
        e: (r,) right sides.
        preference: (n,) weight of variables as pivots, 0 for never.
        pivot: (r,) filled with the pivot of each row, -1 for redundant rows.

    Returns:
        False if rows contradict.
    """
    r, n = E.shape
    for i in range(r):
        largest, best_score, column = 0.0, 0.0, -1
        for j in range(n):
            size = abs(E[i, j])
            largest = max(largest, size)
            if size * preference[j] > best_score:
                best_score, column = size * preference[j], j
        pivot[i] = -1
        if column < 0 or abs(E[i, column]) <= _PIVOT:
            if largest <= _PIVOT and abs(e[i]) > 1e-7:
                return False
            continue
        pivot[i] = column
        scale = 1.0 / E[i, column]
        for j in range(n):
            E[i, j] *= scale
        e[i] *= scale
        E[i, column] = 1.0
        for k in range(r):
            if k != i and E[k, column] != 0.0:
                factor = E[k, column]
                for j in range(n):
                    E[k, j] -= factor * E[i, j]
                e[k] -= factor * e[i]
                E[k, column] = 0.0
    return True


@compiled
def multiply_sparse(left: Array, right: Array) -> Array:
    """Return left @ right, (m, n) by (n, r), skipping zeros of left."""
    m, n = left.shape
    r = right.shape[1]
    product = np.zeros((m, r))
    for i in range(m):
        for j in range(n):
            a = left[i, j]
            if a != 0.0:
                for k in range(r):
                    product[i, k] += a * right[j, k]
    return product
