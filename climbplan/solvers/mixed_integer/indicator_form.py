"""Write an instance as plain rows and indicator rows.

An indicator row has to hold where a binary has a given value. A choice between two alternatives is
one binary, called a switch. A choice among more has a binary for each alternative, exactly one of
which is 1, and a single alternative is a binary fixed to 1. These binaries are numbered after the
instance's variables. The form is exact: nothing is relaxed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class IndicatorForm:
    """Problem lower <= x <= upper with plain rows and indicator rows.

    Indicator row i states that x[indicator_i] = value_i implies that C_i x is within its bounds.
    """

    size: int  # number of variables: those of the instance, then binaries of choices
    lower: Array  # (size,)
    upper: Array
    integer: BoolArray  # (size,)
    A: sparse.csr_matrix  # (m, size)
    row_lower: Array  # (m,)
    row_upper: Array
    C: sparse.csr_matrix  # (c, size)
    indicator_lower: Array  # (c,)
    indicator_upper: Array
    indicator: IntArray  # (c,) index of the binary in x
    value: IntArray  # (c,) 0 or 1
    choice: tuple[IntArray, ...]  # binaries of each choice, or its one switch

    def decode_alternatives(self, x: Array) -> IntArray:
        """Return the chosen alternative of each choice at x (size,)."""
        return np.array(
            [int(x[b[0]] < 0.5) if len(b) == 1 else int(np.argmax(x[b])) for b in self.choice],
            np.int64,
        )

    def encode_point(self, x: Array, assignment: IntArray) -> Array:
        """Return x (n,) followed by the binaries of an assignment."""
        out = np.zeros(self.size)
        out[: len(x)] = x
        for binaries, chosen in zip(self.choice, assignment, strict=True):
            if len(binaries) == 1:
                out[binaries[0]] = float(chosen == 0)
            else:
                out[binaries[int(chosen)]] = 1.0
        return out


def build_indicator_form(instance: Instance) -> IndicatorForm:
    """Build the indicator form of an instance without products and smooth rows.

    Balls are not part of the form.
    """
    n = instance.size
    count = [1 if len(c.alternatives) == 2 else len(c.alternatives) for c in instance.choices]
    first = n + np.concatenate([[0], np.cumsum(count)]).astype(int)
    size = int(first[-1])
    implications = instance.implications
    A, low, high = [_widen(instance.A, size)], [instance.row_lower], [instance.row_upper]
    C, indicator_low, indicator_high = (
        [_widen(implications.A, size)],
        [implications.lower],
        [implications.upper],
    )
    indicator, value = [implications.binary], [implications.value.astype(np.int64)]
    groups = []
    for choice, start, binaries in zip(instance.choices, first, count, strict=False):
        group = np.arange(start, start + binaries)
        groups.append(group)
        if binaries > 1:
            exactly_one = sparse.csr_matrix(
                (np.ones(binaries), (np.zeros(binaries, int), group)), (1, size)
            )
            A.append(exactly_one)
            low.append(np.ones(1))
            high.append(np.ones(1))
        for r, polytope in enumerate(choice.alternatives):
            rows = np.vstack([polytope.A, polytope.C])
            offset = rows @ choice.e
            m = len(offset)
            C.append(_widen(sparse.csr_matrix(sparse.csr_matrix(rows) @ choice.E), size))
            indicator_low.append(
                np.concatenate([np.full(len(polytope.b), -np.inf), polytope.c]) - offset
            )
            indicator_high.append(np.concatenate([polytope.b, polytope.c]) - offset)
            one_of_two = len(choice.alternatives) == 2
            indicator.append(np.full(m, start if one_of_two else start + r, np.int64))
            value.append(np.full(m, int(r == 0) if one_of_two else 1, np.int64))
    num_binaries = size - n
    lower_bound = [float(len(c.alternatives) == 1) for c in instance.choices]
    return IndicatorForm(
        size=size,
        lower=np.concatenate([instance.lower, np.repeat(lower_bound, count)]),
        upper=np.concatenate([instance.upper, np.ones(num_binaries)]),
        integer=np.concatenate([instance.integer, np.ones(num_binaries, bool)]),
        A=sparse.vstack(A).tocsr() if len(A) > 1 else A[0],
        row_lower=np.concatenate(low),
        row_upper=np.concatenate(high),
        C=sparse.vstack(C).tocsr() if len(C) > 1 else C[0],
        indicator_lower=np.concatenate(indicator_low),
        indicator_upper=np.concatenate(indicator_high),
        indicator=np.concatenate(indicator),
        value=np.concatenate(value),
        choice=tuple(groups),
    )


def _widen(rows: sparse.csr_matrix, columns: int) -> sparse.csr_matrix:
    """Return the same rows with more columns."""
    rows = sparse.csr_matrix(rows)
    return sparse.csr_matrix((rows.data, rows.indices, rows.indptr), (rows.shape[0], columns))
