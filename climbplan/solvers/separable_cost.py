"""Factor a convex quadratic cost into a sum of squares of sparse rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance

_FLAT = 1e-12
_ZERO = 1e-12


@dataclass(frozen=True)
class SeparableCost:
    """Cost 1/2 sum (U x + offset)^2 + slope x + constant."""

    U: sparse.csr_matrix  # (S, n)
    offset: Array  # (S,)
    slope: Array  # (n,) along directions without curvature
    constant: float

    def values(self, x: Array) -> Array:
        """Return U x + offset, (S,)."""
        return np.asarray(self.U @ x + self.offset)


def factor_cost(instance: Instance) -> SeparableCost:
    """Factor 1/2 x'Px + q'x for each block of variables that P couples."""
    n = instance.size
    P = sparse.csr_matrix(instance.P)
    P.eliminate_zeros()
    slope, constant = instance.q.copy(), instance.constant
    curved = np.flatnonzero(np.diff(P.indptr))
    row: list[IntArray] = []
    column: list[IntArray] = []
    value: list[Array] = []
    offsets: list[Array] = []
    count = 0
    num_blocks, label = connected_components(P[curved][:, curved], directed=False)
    for block in range(num_blocks):
        index = curved[label == block]
        H, g = P[index][:, index].toarray(), instance.q[index]
        try:
            factor = np.linalg.cholesky(H).T
            offset = np.linalg.solve(factor.T, g)
            slope[index] = 0.0
        except np.linalg.LinAlgError:
            size, vector = np.linalg.eigh(H)
            steep = size > _FLAT * max(1.0, float(size.max()))
            factor = np.sqrt(size[steep])[:, None] * vector[:, steep].T
            offset = (vector[:, steep].T @ g) / np.sqrt(size[steep])
            slope[index] = vector[:, ~steep] @ (vector[:, ~steep].T @ g)
        factor[np.abs(factor) < _ZERO] = 0.0
        constant -= float(0.5 * offset @ offset)
        r, c = np.nonzero(factor)
        row.append(np.asarray(r + count, np.int64))
        column.append(index[c])
        value.append(factor[r, c])
        offsets.append(offset)
        count += len(offset)
    if not count:
        return SeparableCost(sparse.csr_matrix((0, n)), np.zeros(0), slope, constant)
    positions = (np.concatenate(row), np.concatenate(column))
    U = sparse.csr_matrix((np.concatenate(value), positions), shape=(count, n))
    return SeparableCost(U, np.concatenate(offsets), slope, constant)
