"""An instance as plain rows and rows that hold where an integer has a value.

A choice between two alternatives is one switch, one among more has a binary for each alternative,
of which exactly one is 1, and a single alternative a binary that is 1. They are numbered behind the
instance's variables. Nothing is relaxed here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class Conditional:
    """lower <= x <= upper, rows, and x[integer_i] = value_i implies row_i within its bounds."""

    size: int  # of x: the instance's variables, then switches and binaries of choices
    lower: Array  # (size,)
    upper: Array
    integer: BoolArray  # (size,)
    A: sparse.csr_matrix  # (m, size)
    row_lower: Array  # (m,)
    row_upper: Array
    C: sparse.csr_matrix  # (c, size)
    when_lower: Array  # (c,)
    when_upper: Array
    when: IntArray  # (c,) the integer's place in x
    value: IntArray  # (c,) 0 or 1
    choice: tuple[IntArray, ...]  # of each choice its binaries, or its one switch

    def alternatives(self, x: Array) -> IntArray:
        """Chosen alternative of each choice at x (size,)."""
        return np.array(
            [int(x[b[0]] < 0.5) if len(b) == 1 else int(np.argmax(x[b])) for b in self.choice],
            np.int64,
        )

    def point(self, x: Array, assignment: IntArray) -> Array:
        """x (n,) with the binaries of an assignment behind it."""
        out = np.zeros(self.size)
        out[: len(x)] = x
        for binaries, chosen in zip(self.choice, assignment, strict=True):
            if len(binaries) == 1:
                out[binaries[0]] = float(chosen == 0)
            else:
                out[binaries[int(chosen)]] = 1.0
        return out


def conditional_form(instance: Instance) -> Conditional:
    """The form of an instance without products and smooth rows; balls are not part of it."""
    n = instance.size
    count = [1 if len(c.alternatives) == 2 else len(c.alternatives) for c in instance.choices]
    first = n + np.concatenate([[0], np.cumsum(count)]).astype(int)
    size = int(first[-1])
    implied = instance.implications
    A, low, high = [_wide(instance.A, size)], [instance.row_lower], [instance.row_upper]
    C, when_low, when_high = [_wide(implied.A, size)], [implied.lower], [implied.upper]
    when, value = [implied.binary], [implied.value.astype(np.int64)]
    groups = []
    for choice, start, binaries in zip(instance.choices, first, count, strict=False):
        group = np.arange(start, start + binaries)
        groups.append(group)
        if binaries > 1:
            one = sparse.csr_matrix(
                (np.ones(binaries), (np.zeros(binaries, int), group)), (1, size)
            )
            A.append(one)
            low.append(np.ones(1))
            high.append(np.ones(1))
        for r, polytope in enumerate(choice.alternatives):
            rows = np.vstack([polytope.A, polytope.C])
            offset = rows @ choice.e
            m = len(offset)
            C.append(_wide(sparse.csr_matrix(sparse.csr_matrix(rows) @ choice.E), size))
            when_low.append(
                np.concatenate([np.full(len(polytope.b), -np.inf), polytope.c]) - offset
            )
            when_high.append(np.concatenate([polytope.b, polytope.c]) - offset)
            one_of_two = len(choice.alternatives) == 2
            when.append(np.full(m, start if one_of_two else start + r, np.int64))
            value.append(np.full(m, int(r == 0) if one_of_two else 1, np.int64))
    extra = size - n
    only = [float(len(c.alternatives) == 1) for c in instance.choices]
    return Conditional(
        size=size,
        lower=np.concatenate([instance.lower, np.repeat(only, count)]),
        upper=np.concatenate([instance.upper, np.ones(extra)]),
        integer=np.concatenate([instance.integer, np.ones(extra, bool)]),
        A=sparse.vstack(A).tocsr() if len(A) > 1 else A[0],
        row_lower=np.concatenate(low),
        row_upper=np.concatenate(high),
        C=sparse.vstack(C).tocsr() if len(C) > 1 else C[0],
        when_lower=np.concatenate(when_low),
        when_upper=np.concatenate(when_high),
        when=np.concatenate(when),
        value=np.concatenate(value),
        choice=tuple(groups),
    )


def _wide(rows: sparse.csr_matrix, columns: int) -> sparse.csr_matrix:
    rows = sparse.csr_matrix(rows)
    return sparse.csr_matrix((rows.data, rows.indices, rows.indptr), (rows.shape[0], columns))
