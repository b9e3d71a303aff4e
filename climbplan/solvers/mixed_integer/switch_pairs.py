"""Aggregate the indicator rows of switches: binaries that occur in indicator rows only.

Let a_i x <= b_i hold where a switch is 1, c_j x <= d_j where it is 0, and let M_i, N_j be the
largest violations of these rows over the box. Undecided nodes then satisfy

    (a_i x - b_i) / M_i + (c_j x - d_j) / N_j <= 1,

which is the projection of the two big-M rows onto x: the binary needs no column.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.propagation import compute_interval

_PAIRS = 4  # largest ratio of pairs to rows; a binary with more pairs keeps its column
_SLACK = 1e-9


def find_switches(instance: Instance, form: IndicatorForm) -> BoolArray:
    """Return (size,) mask of the binaries that are treated as switches.

    A switch occurs in indicator rows only, and has few enough pairs of rows to be worth it.
    """
    is_switch = np.zeros(form.size, bool)
    is_switch[form.indicator] = True
    is_switch[form.A.indices[form.A.data != 0]] = False
    is_switch[form.C.indices[form.C.data != 0]] = False
    n = instance.size
    is_switch[:n] &= (instance.q == 0) & (np.diff(instance.P.indptr) == 0)
    sides = np.isfinite(form.indicator_lower).astype(int) + np.isfinite(form.indicator_upper)
    ones = np.bincount(form.indicator, sides * (form.value == 1), form.size)
    zeros = np.bincount(form.indicator, sides * (form.value == 0), form.size)
    return is_switch & form.integer & (ones * zeros <= _PAIRS * (ones + zeros))


@compiled
def compute_row_intervals(
    pointer: NDArray[np.int32], index: NDArray[np.int32], data: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Return the minimum and the maximum of every row over the box."""
    m = len(pointer) - 1
    minimum, maximum = np.empty(m), np.empty(m)
    for r in range(m):
        minimum[r], maximum[r] = compute_interval(
            pointer[r], pointer[r + 1], index, data, lower, upper
        )
    return minimum, maximum


@compiled
def pair_indicator_rows(
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
    """Pair every row side for value 1 with every row side for value 0 of each undecided switch.

    Sides whose largest violation over the box is zero or infinite are skipped.

    Returns:
        For each pair: row for 1, its sign, row for 0, its sign, their largest violations, switch.
    """
    count = 0
    for fill in range(2):
        if fill == 1:
            a, c = np.empty(count, np.int64), np.empty(count, np.int64)
            sign_a, sign_c = np.empty(count), np.empty(count)
            big_m_a, big_m_c = np.empty(count), np.empty(count)
            switch_of_pair = np.empty(count, np.int64)
            count = 0
        for s in range(len(entities)):
            if not switch[entities[s]]:
                continue
            for i in range(first[s], first[s + 1]):
                row_one = order[i]
                if value[row_one] != 1 or not free[row_one]:
                    continue
                for j in range(first[s], first[s + 1]):
                    row_zero = order[j]
                    if value[row_zero] != 0:
                        continue
                    for side in range(4):
                        up_a, up_c = side < 2, side % 2 == 0
                        violation_a = excess_high[row_one] if up_a else excess_low[row_one]
                        violation_c = excess_high[row_zero] if up_c else excess_low[row_zero]
                        if not (violation_a > _SLACK and violation_c > _SLACK):
                            continue
                        if np.isinf(violation_a) or np.isinf(violation_c):
                            continue
                        if fill == 1:
                            a[count], c[count], switch_of_pair[count] = row_one, row_zero, s
                            sign_a[count] = 1.0 if up_a else -1.0
                            sign_c[count] = 1.0 if up_c else -1.0
                            big_m_a[count], big_m_c[count] = violation_a, violation_c
                        count += 1
    return a, sign_a, c, sign_c, big_m_a, big_m_c, switch_of_pair
