"""Write an instance as plain rows and indicator rows.

An indicator row has to hold where a binary has a given value. A choice between two alternatives is
one binary, called a switch. A choice among more has a binary for each alternative, exactly one of
which is 1, and a single alternative is a binary fixed to 1. These binaries are numbered after the
instance's variables. The form is exact: nothing is relaxed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

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
    groups = [np.arange(begin, end) for begin, end in pairwise(first)]
    for group in groups:
        if len(group) > 1:
            places = np.zeros(len(group), int), group
            A.append(sparse.csr_matrix((np.ones(len(group)), places), (1, size)))
            low.append(np.ones(1))
            high.append(np.ones(1))
    if instance.choices:
        matrices = [
            np.vstack([matrix for p in choice.alternatives for matrix in (p.A, p.C)])
            for choice in instance.choices
        ]
        points = sparse.vstack([choice.E for choice in instance.choices]).tocsr()
        C.append(_widen(_stack_diagonally(matrices) @ points, size))
    for choice, start in zip(instance.choices, first, strict=False):
        one_of_two = len(choice.alternatives) == 2
        for r, polytope in enumerate(choice.alternatives):
            offset = np.concatenate([polytope.A @ choice.e, polytope.C @ choice.e])
            ends = np.concatenate([polytope.b, polytope.c]) - offset
            indicator_high.append(ends)
            indicator_low.append(np.where(np.arange(len(ends)) < len(polytope.b), -np.inf, ends))
            indicator.append(np.full(len(ends), start if one_of_two else start + r, np.int64))
            value.append(np.full(len(ends), int(r == 0) if one_of_two else 1, np.int64))
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


def _stack_diagonally(blocks: Sequence[Array]) -> sparse.csr_matrix:
    """Return the block diagonal matrix of dense blocks, without their zeros."""
    shapes = np.array([block.shape for block in blocks]).reshape(-1, 2)
    begins = np.cumsum(np.vstack([[[0, 0]], shapes]), axis=0)
    places = [np.nonzero(block) for block in blocks]
    row, column = (
        np.concatenate([p[side] + begins[i, side] for i, p in enumerate(places)]) for side in (0, 1)
    )
    entries = np.concatenate([block[place] for block, place in zip(blocks, places, strict=True)])
    return sparse.csr_matrix((entries, (row, column)), shape=tuple(begins[-1]))


def _widen(rows: sparse.csr_matrix, columns: int) -> sparse.csr_matrix:
    """Return the same rows with more columns."""
    rows = sparse.csr_matrix(rows)
    return sparse.csr_matrix((rows.data, rows.indices, rows.indptr), (rows.shape[0], columns))
