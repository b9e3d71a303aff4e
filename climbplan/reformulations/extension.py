"""Append variables and rows to an instance, the last step of all reformulations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.program.instance import Balls, Choice, Implications, Instance


@dataclass
class TripletRows:
    """Rows of triplets, collected block by block: lower <= sum of entries <= upper."""

    count: int = 0
    _row: list[Array] = field(default_factory=list)
    _column: list[Array] = field(default_factory=list)
    _value: list[Array] = field(default_factory=list)
    _lower: list[Array] = field(default_factory=list)
    _upper: list[Array] = field(default_factory=list)

    def add(
        self,
        rows: int,
        entries: Sequence[tuple[ArrayLike, ...]],
        lower: ArrayLike,
        upper: ArrayLike,
    ) -> None:
        """Append rows; entries are (row, column, value), broadcast, with rows counted from here."""
        for entry in entries:
            row, column, value = (np.ravel(array) for array in np.broadcast_arrays(*entry))
            self._row.append(row + self.count)
            self._column.append(column)
            self._value.append(value)
        self._lower.append(np.broadcast_to(np.asarray(lower, float), rows))
        self._upper.append(np.broadcast_to(np.asarray(upper, float), rows))
        self.count += rows

    def matrix(self, columns: int) -> sparse.csr_matrix:
        """Return all rows (m, columns)."""
        if not self._row:
            return sparse.csr_matrix((self.count, columns))
        positions = (
            np.concatenate(self._row).astype(int),
            np.concatenate(self._column).astype(int),
        )
        value = np.concatenate(self._value).astype(float)
        return sparse.csr_matrix((value, positions), shape=(self.count, columns))

    @property
    def lower(self) -> Array:
        """Lower bounds (m,)."""
        return np.concatenate([np.zeros(0), *self._lower])

    @property
    def upper(self) -> Array:
        """Upper bounds (m,)."""
        return np.concatenate([np.zeros(0), *self._upper])


@dataclass(frozen=True)
class Extension:
    """Variables after those of an instance, and rows over both."""

    lower: Array  # (k,)
    upper: Array  # (k,)
    integer: BoolArray  # (k,)
    A: sparse.csr_matrix  # (m, n + k)
    row_lower: Array  # (m,)
    row_upper: Array  # (m,)
    Q: sparse.csr_matrix | None = None  # (m, K) products in the new rows


def extend_instance(instance: Instance, extension: Extension) -> Instance:
    """Return the instance with the variables and rows of the extension."""
    k, m = len(extension.lower), extension.A.shape[0]
    n, K = instance.size, instance.products.count
    Q = sparse.csr_matrix((m, K)) if extension.Q is None else extension.Q
    P = sparse.csc_matrix(instance.P)
    indptr = np.concatenate([P.indptr, np.full(k, P.indptr[-1])])
    return replace(
        instance,
        P=sparse.csc_matrix((P.data, P.indices, indptr), shape=(n + k, n + k)),
        q=np.concatenate([instance.q, np.zeros(k)]),
        lower=np.concatenate([instance.lower, extension.lower]),
        upper=np.concatenate([instance.upper, extension.upper]),
        integer=np.concatenate([instance.integer, extension.integer]),
        A=sparse.vstack([append_columns(instance.A, k), extension.A]).tocsr(),
        row_lower=np.concatenate([instance.row_lower, extension.row_lower]),
        row_upper=np.concatenate([instance.row_upper, extension.row_upper]),
        Q=sparse.vstack([instance.Q, Q]).tocsr(),
        balls=tuple(
            Balls(
                append_columns(b.F, k),
                b.f,
                b.radius,
                None if b.slope is None else append_columns(b.slope, k),
            )
            for b in instance.balls
        ),
        choices=tuple(
            Choice(c.name, append_columns(c.E, k), c.e, c.alternatives) for c in instance.choices
        ),
        implications=replace(instance.implications, A=append_columns(instance.implications.A, k)),
    )


def append_columns(rows: sparse.csr_matrix, k: int) -> sparse.csr_matrix:
    """Return the rows with k empty columns appended."""
    rows = sparse.csr_matrix(rows)
    shape = (rows.shape[0], rows.shape[1] + k)
    return sparse.csr_matrix((rows.data, rows.indices, rows.indptr), shape=shape)


def create_no_implications(n: int, K: int) -> Implications:
    """Return no implications over n variables and K products."""
    return Implications(
        A=sparse.csr_matrix((0, n)),
        Q=sparse.csr_matrix((0, K)),
        lower=np.zeros(0),
        upper=np.zeros(0),
        binary=np.zeros(0, np.int64),
        value=np.zeros(0, bool),
    )
