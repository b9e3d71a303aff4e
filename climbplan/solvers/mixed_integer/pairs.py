"""Switches: binaries that stand in conditional rows alone, whose rows are joined in pairs.

With a_i x <= b_i where a switch is 1, c_j x <= d_j where it is 0, and M_i, N_j the most by which
these fail over the box, undecided nodes have (a_i x - b_i) / M_i + (c_j x - d_j) / N_j <= 1, which
is what big-M rows say of x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.propagation import interval

_PAIRS = 4  # times as many pairs as rows: a binary with more keeps its column
_SLACK = 1e-9


def switches(instance: Instance, form: Conditional) -> BoolArray:
    """Binaries that stand in conditional rows alone, few enough of them to be paired."""
    alone = np.zeros(form.size, bool)
    alone[form.when] = True
    alone[form.A.indices[form.A.data != 0]] = False
    alone[form.C.indices[form.C.data != 0]] = False
    n = instance.size
    alone[:n] &= (instance.q == 0) & (np.diff(instance.P.indptr) == 0)
    sides = np.isfinite(form.when_lower).astype(int) + np.isfinite(form.when_upper)
    ones = np.bincount(form.when, sides * (form.value == 1), form.size)
    zeros = np.bincount(form.when, sides * (form.value == 0), form.size)
    return alone & form.integer & (ones * zeros <= _PAIRS * (ones + zeros))


@compiled
def row_intervals(
    pointer: NDArray[np.int32], index: NDArray[np.int32], data: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Least and largest value of every row over the box."""
    m = len(pointer) - 1
    least, most = np.empty(m), np.empty(m)
    for r in range(m):
        least[r], most[r] = interval(pointer[r], pointer[r + 1], index, data, lower, upper)
    return least, most


@compiled
def paired(
    entities: IntArray,
    switch: BoolArray,
    first: IntArray,
    order: IntArray,
    value: IntArray,
    free: BoolArray,
    excess_low: Array,
    excess_high: Array,
    when_lower: Array,
    when_upper: Array,
) -> tuple[IntArray, Array, IntArray, Array, Array, Array, IntArray]:
    """For each undecided switch every side of a row for 1 with every side of a row for 0.

    Rows, signs, excesses and the integer; sides without an excess or without a finite one are left.
    """
    count = 0
    for turn in range(2):
        if turn == 1:
            a, c = np.empty(count, np.int64), np.empty(count, np.int64)
            sign_a, sign_c = np.empty(count), np.empty(count)
            most_a, most_c = np.empty(count), np.empty(count)
            of = np.empty(count, np.int64)
            count = 0
        for s in range(len(entities)):
            if not switch[entities[s]]:
                continue
            for i in range(first[s], first[s + 1]):
                one = order[i]
                if value[one] != 1 or not free[one]:
                    continue
                for j in range(first[s], first[s + 1]):
                    zero = order[j]
                    if value[zero] != 0:
                        continue
                    for side in range(4):
                        up_a, up_c = side < 2, side % 2 == 0
                        m_a = excess_high[one] if up_a else excess_low[one]
                        m_c = excess_high[zero] if up_c else excess_low[zero]
                        if not (m_a > _SLACK and m_c > _SLACK):
                            continue
                        if np.isinf(m_a) or np.isinf(m_c):
                            continue
                        if turn == 1:
                            a[count], c[count], of[count] = one, zero, s
                            sign_a[count] = 1.0 if up_a else -1.0
                            sign_c[count] = 1.0 if up_c else -1.0
                            most_a[count], most_c[count] = m_a, m_c
                        count += 1
    return a, sign_a, c, sign_c, most_a, most_c, of
