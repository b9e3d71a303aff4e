"""Indicator rows: implications, and alternatives of choices.

An alternative of a choice is the implication "d = 1 => its rows", with one indicator d for each
alternative. All reformulations therefore treat both in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class IndicatorRows:
    """Rows for which v[indicator_i] = value_i implies lower_i <= A_i x + Q_i w <= upper_i.

    Here v = (x, d) are the variables and one indicator for each alternative of each choice.
    """

    A: sparse.csr_matrix  # (m, n)
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,)
    upper: Array  # (m,)
    indicator: IntArray  # (m,)
    value: BoolArray  # (m,)

    def find_active(self, v: Array) -> BoolArray:
        """Return the mask of rows that must hold at v, with indicators rounded."""
        return np.asarray((v[self.indicator] > 0.5) == self.value)


@dataclass(frozen=True)
class BigMConstants:
    """Tight big-M constants: largest violations of indicator rows where they need not hold."""

    below: Array  # (m,) lower - minimum, at least 0
    above: Array  # (m,) maximum - upper, at least 0


def build_indicator_rows(instance: Instance) -> IndicatorRows:
    """Build the rows of implications, then those of the alternatives of all choices."""
    n, K = instance.size, instance.products.count
    implications = instance.implications
    A, lower, upper = [implications.A], [implications.lower], [implications.upper]
    indicator: list[IntArray] = [implications.binary]
    column = n
    for choice in instance.choices:
        for polytope in choice.alternatives:
            rows = np.vstack([polytope.A, polytope.C])
            bound = np.concatenate([polytope.b, polytope.c]) - rows @ choice.e
            A.append(sparse.csr_matrix(sparse.csr_matrix(rows) @ choice.E))
            open_below = np.arange(len(rows)) < len(polytope.b)
            lower.append(np.where(open_below, -np.inf, bound))
            upper.append(bound)
            indicator.append(np.full(len(rows), column, np.int64))
            column += 1
    stacked = sparse.vstack(A).tocsr()
    extra = stacked.shape[0] - implications.count
    return IndicatorRows(
        A=canonicalise(stacked),
        Q=canonicalise(sparse.vstack([implications.Q, sparse.csr_matrix((extra, K))]).tocsr()),
        lower=np.concatenate(lower),
        upper=np.concatenate(upper),
        indicator=np.concatenate(indicator),
        value=np.concatenate([implications.value, np.ones(extra, bool)]),
    )


def compute_big_m(instance: Instance, rows: IndicatorRows) -> BigMConstants:
    """Compute the big-M of every row over the propagated box, products included.

    Raises:
        UsageError: A bound that is needed is missing.
    """
    reach = propagate_box(instance).interval(rows.A, rows.Q)
    with np.errstate(invalid="ignore"):  # infinite bound of a row without bounds on its value
        below = np.maximum(rows.lower - reach.lower, 0.0)
        above = np.maximum(reach.upper - rows.upper, 0.0)
    is_missing = np.isfinite(rows.lower) & ~np.isfinite(below)
    is_missing |= np.isfinite(rows.upper) & ~np.isfinite(above)
    if is_missing.any():
        raise UsageError(
            f"{instance.name}: big-M needs bounds on all variables of implications and choices "
            f"({int(is_missing.sum())} rows lack them)"
        )
    return BigMConstants(
        np.where(np.isfinite(rows.lower), below, 0.0), np.where(np.isfinite(rows.upper), above, 0.0)
    )


def canonicalise(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """Return the same matrix with sorted indices and no duplicates; explicit zeros are kept."""
    result = sparse.csr_matrix(matrix, copy=True)
    result.sum_duplicates()
    return result
