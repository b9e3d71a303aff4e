"""Rows that hold only where an indicator has a value: implications and alternatives of choices.

An alternative of a choice is the implication "d = 1 => its rows", with one indicator d for each
alternative. So both go the same way through every reformulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array


@dataclass(frozen=True)
class ConditionalRows:
    """v[indicator_i] = value_i implies lower_i <= A_i x + Q_i w <= upper_i.

    v = (x, d): the instance's variables and one indicator for each alternative of each choice.
    """

    A: sparse.csr_matrix  # (m, n)
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,)
    upper: Array  # (m,)
    indicator: Index  # (m,)
    value: NDArray[np.bool_]  # (m,)

    def active(self, v: Array) -> NDArray[np.bool_]:
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
    indicator: list[Index] = [implied.binary]
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
    """Big-M of every row by interval arithmetic over the variables' bounds, products included.

    Raises UsageError where a bound that is needed is missing.
    """
    low, high = instance.lower, instance.upper
    w_low, w_high = product_range(instance)
    least, most = _range(rows.A, low, high), _range(rows.Q, w_low, w_high)
    with np.errstate(invalid="ignore"):  # infinite bound of a row without bounds on its value
        below = np.maximum(rows.lower - least[0] - most[0], 0.0)
        above = np.maximum(least[1] + most[1] - rows.upper, 0.0)
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


def product_range(instance: Instance) -> tuple[Array, Array]:
    """Least and largest value of each product over the variables' bounds; NaN where unknown."""
    low, high = instance.lower, instance.upper
    first, second = instance.products.first, instance.products.second
    with np.errstate(invalid="ignore"):  # zero times infinity
        corners = np.stack([a[first] * b[second] for a in (low, high) for b in (low, high)])
    least, most = corners.min(axis=0), corners.max(axis=0)
    return np.where(first == second, np.maximum(least, 0.0), least), most


def canonical(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """The same matrix with sorted indices and no duplicates; explicit zeros are kept."""
    out = sparse.csr_matrix(matrix, copy=True)
    out.sum_duplicates()
    return out


def _range(matrix: sparse.csr_matrix, low: Array, high: Array) -> tuple[Array, Array]:
    """Least and largest value of each row over a box; NaN and infinite ends pass through."""
    entry = matrix.tocoo()
    used = entry.data != 0
    row, column, a = entry.row[used], entry.col[used], entry.data[used]
    one, other = a * low[column], a * high[column]
    m = matrix.shape[0]
    least, most = np.zeros(m), np.zeros(m)
    np.add.at(least, row, np.minimum(one, other))
    np.add.at(most, row, np.maximum(one, other))
    return least, most
