"""Least-distance program min |z|^2 / 2 subject to C z >= b, by a dual active-set method.

The primal is recovered from multipliers of at most as many rows as there are variables, so that a
few dense operations on tiny matrices are all there is (the method of Goldfarb and Idnani for an
identity Hessian). The multipliers are non-negative at every stage: whoever wants a bound evaluates
the Lagrangian with them and need not trust the rest.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled

SOLVED, EMPTY, CUT_OFF, STUCK = 0, 1, 2, 3

_SATISFIED = 1e-8  # largest violation of a row, in units of its norm
_DEPENDENT = 1e-11  # relative pivot below which a row depends on the active ones


@compiled
def _factorise(C: Array, active: IntArray, count: int, factor: Array) -> bool:
    """Factorise the Gram matrix of the active rows by Cholesky's method.

    Returns False if the last row depends linearly on the others.
    """
    for i in range(count):
        row = C[active[i]]
        for j in range(i + 1):
            total = 0.0
            for k in range(C.shape[1]):
                total += row[k] * C[active[j], k]
            if j == i:
                min_pivot = _DEPENDENT * total
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = total / factor[j, j]
            elif total <= min_pivot:
                if i == count - 1:
                    return False
                factor[i, i] = math.sqrt(min_pivot)  # by rounding only: keep the factor finite
            else:
                factor[i, i] = math.sqrt(total)
    return True


@compiled
def _solve_factored(factor: Array, count: int, step: Array) -> None:
    """Overwrite step[:count] with the solution of (factor factor^T) s = step."""
    for i in range(count):
        for k in range(i):
            step[i] -= factor[i, k] * step[k]
        step[i] /= factor[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            step[i] -= factor[k, i] * step[k]
        step[i] /= factor[i, i]


@compiled
def _find_worst_row(C: Array, b: Array, norm: Array, z: Array) -> int:
    """Return the row that z violates most, in units of its norm (rows,); -1 without one."""
    worst, max_violation = -1, _SATISFIED
    for r in range(C.shape[0]):
        total = b[r]
        for k in range(C.shape[1]):
            total -= C[r, k] * z[k]
        if total > max_violation * norm[r] and norm[r] > 0.0:
            worst, max_violation = r, total / norm[r]
    return worst


@compiled
def solve_least_distance(C: Array, b: Array, cutoff: float, multiplier: Array, z: Array) -> int:
    """Solve for C (rows, variables) and b (rows,); fills multiplier (rows,) and z (variables,).

    Returns SOLVED; EMPTY if no z satisfies the rows, as C^T multiplier = 0 and b . multiplier > 0
    prove; CUT_OFF if the value exceeds `cutoff`, which the Lagrangian with `multiplier` shows; or
    STUCK at the iteration limit, reached only through rounding.
    """
    rows, variables = C.shape
    multiplier[:] = 0.0
    z[:] = 0.0
    norm = np.empty(rows)
    active = np.empty(variables + 1, np.int64)
    value, step = np.empty(variables + 1), np.empty(variables + 1)
    factor = np.empty((variables + 1, variables + 1))
    for r in range(rows):
        total = 0.0
        for k in range(variables):
            total += C[r, k] * C[r, k]
        norm[r] = math.sqrt(total)
        if total == 0.0 and b[r] > _SATISFIED:
            multiplier[r] = 1.0
            return EMPTY
    count, result = 0, STUCK
    for _ in range(20 * (rows + 1)):
        worst = _find_worst_row(C, b, norm, z)
        if worst < 0:
            result = SOLVED
            break
        repeated = False
        for i in range(count):
            repeated = repeated or active[i] == worst
        if repeated:  # an active row is violated: rounding prevents further progress
            break
        active[count], value[count] = worst, 0.0
        count += 1
        num_active = _update_multipliers(C, b, active, value, step, factor, count)
        if num_active < 0:
            for i in range(-num_active):
                multiplier[active[i]] = max(0.0, step[i])
            return EMPTY
        count = num_active
        dual_value = 0.0
        z[:] = 0.0
        for i in range(count):
            dual_value += value[i] * b[active[i]]
            for k in range(variables):
                z[k] += value[i] * C[active[i], k]
        for k in range(variables):
            dual_value -= 0.5 * z[k] * z[k]
        if dual_value > cutoff:
            result = CUT_OFF
            break
    for i in range(count):
        multiplier[active[i]] = value[i]
    return result


@compiled
def _update_multipliers(
    C: Array,
    b: Array,
    active: IntArray,
    value: Array,
    step: Array,
    factor: Array,
    count: int,
) -> int:
    """Update the multipliers `value` of the active rows; rows that would turn negative are dropped.

    Returns the number of active rows left, or its negative if `step` is a certificate that no z
    satisfies them.
    """
    variables = C.shape[1]
    while count > 0:
        independent = count <= variables and _factorise(C, active, count, factor)
        last = count - 1
        if independent:
            for i in range(count):
                step[i] = b[active[i]]
            _solve_factored(factor, count, step)
        else:
            if count > variables:
                _factorise(C, active, last, factor)
            for i in range(last):
                total = 0.0
                for k in range(variables):
                    total += C[active[i], k] * C[active[last], k]
                step[i] = -total
            _solve_factored(factor, last, step)
            step[last] = 1.0
        # Towards `step` (or along it), as far as no multiplier turns negative.
        blocking, step_length = -1, 1.0 if independent else np.inf
        for i in range(count):
            if independent and step[i] < 0.0:
                ratio = value[i] / (value[i] - step[i])
            elif not independent and step[i] < -1e-12:
                ratio = value[i] / -step[i]
            else:
                continue
            if blocking < 0 or ratio < step_length:
                blocking, step_length = i, ratio
        if blocking < 0 and not independent:
            return -count
        for i in range(count):
            move = step[i] - value[i] if independent else step[i]
            value[i] = max(0.0, value[i] + step_length * move)
        if blocking < 0:
            break
        for k in range(blocking, last):
            active[k], value[k] = active[k + 1], value[k + 1]
        count -= 1
    return count
