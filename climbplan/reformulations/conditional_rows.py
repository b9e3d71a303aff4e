"""Rows that hold only where an indicator has a value: implications and alternatives of choices.

An alternative of a choice is the implication "d = 1 => its rows", with one indicator d for each
alternative. So both go the same way through every reformulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class ConditionalRows:
    """v[indicator_i] = value_i implies lower_i <= A_i x + Q_i w <= upper_i.

    v = (x, d): the instance's variables and one indicator for each alternative of each choice.
    """

    A: sparse.csr_matrix  # (m, n)
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,)
    upper: Array  # (m,)
    indicator: IntArray  # (m,)
    value: BoolArray  # (m,)

    def active(self, v: Array) -> BoolArray:
        """Which rows must hold at v, indicators rounded."""
        return np.asarray((v[self.indicator] > 0.5) == self.value)


@dataclass(frozen=True)
class Excess:
    """How far conditional rows can leave their bounds where they need not hold: tight big-M."""

    below: Array  # (m,) lower - least value, at least 0
    above: Array  # (m,) largest value - upper, at least 0


def conditional_rows(instance: Instance) -> ConditionalRows:
    """Implications first, then the alternatives of all choices in order."""
    n, K = instance.size, instance.products.count
    implied = instance.implications
    A, lower, upper = [implied.A], [implied.lower], [implied.upper]
    indicator: list[IntArray] = [implied.binary]
    at = n
    for choice in instance.choices:
        for polytope in choice.alternatives:
            rows = np.vstack([polytope.A, polytope.C])
            bound = np.concatenate([polytope.b, polytope.c]) - rows @ choice.e
            A.append(sparse.csr_matrix(sparse.csr_matrix(rows) @ choice.E))
            open_below = np.arange(len(rows)) < len(polytope.b)
            lower.append(np.where(open_below, -np.inf, bound))
            upper.append(bound)
            indicator.append(np.full(len(rows), at, np.int64))
            at += 1
    stacked = sparse.vstack(A).tocsr()
    extra = stacked.shape[0] - implied.count
    return ConditionalRows(
        A=canonical(stacked),
        Q=canonical(sparse.vstack([implied.Q, sparse.csr_matrix((extra, K))]).tocsr()),
        lower=np.concatenate(lower),
        upper=np.concatenate(upper),
        indicator=np.concatenate(indicator),
        value=np.concatenate([implied.value, np.ones(extra, bool)]),
    )


def excess(instance: Instance, rows: ConditionalRows) -> Excess:
    """Big-M of every row over the propagated box, products included.

    Raises UsageError where a bound that is needed is missing.
    """
    reach = propagated_box(instance).interval(rows.A, rows.Q)
    with np.errstate(invalid="ignore"):  # infinite bound of a row without bounds on its value
        below = np.maximum(rows.lower - reach.lower, 0.0)
        above = np.maximum(reach.upper - rows.upper, 0.0)
    wanted = np.isfinite(rows.lower) & ~np.isfinite(below)
    wanted |= np.isfinite(rows.upper) & ~np.isfinite(above)
    if wanted.any():
        raise UsageError(
            f"{instance.name}: big-M needs bounds on all variables of implications and choices "
            f"({int(wanted.sum())} rows lack them)"
        )
    return Excess(
        np.where(np.isfinite(rows.lower), below, 0.0), np.where(np.isfinite(rows.upper), above, 0.0)
    )


def canonical(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """The same matrix with sorted indices and no duplicates; explicit zeros are kept."""
    out = sparse.csr_matrix(matrix, copy=True)
    out.sum_duplicates()
    return out
