"""Factor a convex quadratic cost into a sum of squares of sparse rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance

_FLAT = 1e-12
_ZERO = 1e-12
_ROUNDING = 1e-10  # negative curvature that rounding leaves, relative to the largest


class NotConvexCost(UsageError):
    """A cost with negative curvature, where a convex one is needed."""


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


def is_convex(P: sparse.spmatrix) -> bool:
    """Return whether a symmetric matrix has no negative eigenvalue, but for rounding."""
    diagonal = P.diagonal()
    if (diagonal < 0.0).any():
        return False
    if P.count_nonzero() == np.count_nonzero(diagonal):
        return True
    for index, H in _iterate_blocks(sparse.csr_matrix(P)):
        if len(index) == 1:
            continue  # whose diagonal is not negative
        try:
            np.linalg.cholesky(H + _compute_rounding(H) * np.eye(len(index)))
        except np.linalg.LinAlgError:
            return False
    return True


def factor_cost(instance: Instance) -> SeparableCost:
    """Factor 1/2 x'Px + q'x for each block of variables that P couples.

    Raises:
        NotConvexCost: P has a negative eigenvalue.
    """
    n = instance.size
    slope, constant = instance.q.copy(), instance.constant
    row: list[IntArray] = []
    column: list[IntArray] = []
    value: list[Array] = []
    offsets: list[Array] = []
    count = 0
    for index, H in _iterate_blocks(sparse.csr_matrix(instance.P)):
        g = instance.q[index]
        try:
            factor = np.asarray(np.linalg.cholesky(H).T, np.float64)
            offset = np.asarray(np.linalg.solve(factor.T, g), np.float64)
            slope[index] = 0.0
        except np.linalg.LinAlgError:
            size, vector = np.linalg.eigh(H)
            if size[0] < -_compute_rounding(H):
                raise NotConvexCost(describe_nonconvexity(instance.name, float(size[0]))) from None
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


def describe_nonconvexity(name: str, curvature: float | None = None) -> str:
    """Return what is wrong with a cost that is not convex, and what to do."""
    reason = "" if curvature is None else f": its Hessian has the eigenvalue {curvature:.3g}"
    return (
        f"{name}: the cost is not convex{reason}. State it as a row, cost - t <= 0, and minimise "
        "the new variable t, or use method minlp-scip"
    )


def _compute_rounding(H: Array) -> float:
    """Return the negative curvature that counts as rounding."""
    return _ROUNDING * float(np.abs(H).sum(axis=1).max())


def _iterate_blocks(P: sparse.csr_matrix) -> Iterator[tuple[IntArray, Array]]:
    """Yield the variables of each block that P couples, and its dense matrix."""
    P.eliminate_zeros()
    curved = np.flatnonzero(np.diff(P.indptr))
    num_blocks, label = connected_components(P[curved][:, curved], directed=False)
    order = curved[np.argsort(label, kind="stable")]
    sorted_matrix = sparse.csr_matrix(P[order][:, order])
    ends = np.cumsum(np.bincount(label, minlength=num_blocks))
    for begin, end in zip(ends - np.diff(ends, prepend=0), ends, strict=True):
        # The entries of a block's rows, whose columns are all in the block
        pointers = sorted_matrix.indptr[begin : end + 1]
        row = np.repeat(np.arange(end - begin), np.diff(pointers))
        entries = slice(pointers[0], pointers[-1])
        H = np.zeros((end - begin, end - begin))
        H[row, sorted_matrix.indices[entries] - begin] = sorted_matrix.data[entries]
        yield order[begin:end], H
