"""Multipliers of a leaf by Clarabel: of its relaxation, or of how far its rows must be let out.

Both are programs over the rows that certificates are checked in: conditional rows whose binary is
open may fail by what they can in the box, and products have their envelopes. The second has the
least t >= 0 such that some v has every row and every ball within t: where that is more than 0 its
multipliers prove that the leaf is empty, and t is their margin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import Box
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.telling import Multipliers

_FIXED = 1e-10  # width of a range, relative, in which a variable is taken as a number
_ACCURACY = 1e-10


_INFEASIBLE = (
    clarabel.SolverStatus.PrimalInfeasible,
    clarabel.SolverStatus.AlmostPrimalInfeasible,
)


class Relaxed(NamedTuple):
    """A relaxation's multipliers, and its point."""

    multipliers: Multipliers
    v: Array  # (N,)


@dataclass(frozen=True)
class _Sides:
    """A v <= b, or with equality."""

    A: sparse.csr_matrix  # (m, N)
    b: Array
    row: IntArray  # (m,) which row it is of
    sign: Array  # 1 for an upper side and for an equation, -1 for a lower side


def leaf_multipliers(instance: Instance, rows: StatedRows, box: Box, empty: bool) -> Relaxed | None:
    """Of rows with the planes of a leaf's box; without a point, too, where there is none.

    None where nothing is free, or the solver finds nothing at all.
    """
    n, size = instance.size, len(rows.integer)
    width = box.upper - box.lower
    free = np.flatnonzero(width > _FIXED * np.maximum(1.0, np.abs(box.lower)))
    if not len(free):
        return None
    fixed = np.where(np.isfinite(width), 0.5 * (box.lower + box.upper), 0.0)
    fixed[free] = 0.0
    equal = np.zeros(len(rows.lower), bool) if empty else _equations(rows, box)
    parts = [_equal_sides(rows, equal), _both_sides(rows, box, ~equal), _bounds(box, free)]
    kept = []
    for part in parts:
        A = part.A[:, free]
        said = np.flatnonzero(np.diff(A.indptr))
        kept.append(
            _Sides(A[said], (part.b - part.A @ fixed)[said], part.row[said], part.sign[said])
        )
    let_out = [np.zeros(len(kept[0].b)), np.full(len(kept[1].b), -1.0), np.zeros(len(kept[2].b))]
    F, f, reach, lengths = _balls(instance, free, fixed)
    A = sparse.vstack([*(part.A for part in kept), F])
    b = np.concatenate([*(part.b for part in kept), f])
    cones = [clarabel.ZeroConeT(len(kept[0].b))] if len(kept[0].b) else []
    if inequalities := len(kept[1].b) + len(kept[2].b):
        cones.append(clarabel.NonnegativeConeT(inequalities))
    cones += [clarabel.SecondOrderConeT(int(length)) for length in lengths]
    P = sparse.csc_matrix((size, size))
    q = np.zeros(size)
    if not empty:
        P = sparse.block_diag([instance.P, sparse.csc_matrix((size - n, size - n))], format="csc")
        q[:n] = instance.q
        q += P @ fixed
    P, q = sparse.csc_matrix(P[free][:, free]), q[free]
    if empty:
        column = np.concatenate([*let_out, -reach])
        positive = sparse.csr_matrix(([-1.0], ([0], [len(free)])), (1, len(free) + 1))
        A = sparse.vstack([positive, sparse.hstack([A, column[:, None]])])
        b = np.append(0.0, b)
        cones = [clarabel.NonnegativeConeT(1), *cones]
        P, q = sparse.csc_matrix((len(q) + 1, len(q) + 1)), np.append(np.zeros(len(q)), 1.0)
    found = _solved(P, q, A, b, cones)
    if found is None:
        return None
    x, z, none = found
    z = z[1:] if empty else z
    y, at = np.zeros(len(rows.lower)), 0
    for part in kept[:2]:
        np.add.at(y, part.row, -part.sign * z[at : at + len(part.b)])
        at += len(part.b)
    at += len(kept[2].b)
    inside = np.flatnonzero(reach == 0.0)  # behind each ball's radius its coordinates
    ball = -z[at:][inside]
    v = fixed.copy()
    v[free] = np.clip(x[: len(free)], box.lower[free], box.upper[free])
    return Relaxed(Multipliers(None if empty or none else v[:n], y, ball), v)


def _solved(
    P: sparse.csc_matrix, q: Array, A: sparse.spmatrix, b: Array, cones: list[Any]
) -> tuple[Array, Array, bool] | None:
    """Point, multipliers, and whether these show that there is no point."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    settings.tol_infeas_abs = settings.tol_infeas_rel = _ACCURACY
    upper = sparse.csc_matrix(sparse.triu(P))
    solver = clarabel.DefaultSolver(upper, q, sparse.csc_matrix(A), b, cones, settings)
    solution = solver.solve()
    x, z = np.array(solution.x), np.array(solution.z)
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        return None
    return x, z, solution.status in _INFEASIBLE


def _equations(rows: StatedRows, box: Box) -> Any:
    """(rows,) which have one value and have to hold."""
    return box.holding(rows)[0] & (rows.lower == rows.upper)


def _equal_sides(rows: StatedRows, equal: Any) -> _Sides:
    r = np.flatnonzero(equal)
    return _Sides(rows.G[r], rows.upper[r], r, np.ones(len(r)))


def _both_sides(rows: StatedRows, box: Box, which: Any) -> _Sides:
    """Rows that hold, and big-M rows of those whose binary is open."""
    b, (holds, maybe) = rows.binary, box.holding(rows)
    A, bound, row, signs = [], [], [], []
    for sign, side in ((1.0, rows.upper), (-1.0, rows.lower)):
        r = np.flatnonzero(which & np.isfinite(side) & (holds | maybe))
        G = sparse.csr_matrix(sign * rows.G[r])
        ends = G.data * np.stack([box.lower, box.upper])[:, G.indices]
        at = np.repeat(np.arange(len(r)), np.diff(G.indptr))
        most = np.bincount(at, ends.max(axis=0), len(r))
        M = np.where(holds[r], 0.0, np.maximum(most - sign * side[r], 0.0))
        known = np.isfinite(M)
        r, G, M = r[known], G[known], M[known]
        one = rows.value[r] == 1
        slope = sparse.csr_matrix(
            (np.where(one, M, -M), (np.arange(len(r)), np.maximum(b[r], 0))), G.shape
        )
        slope.eliminate_zeros()
        A.append(G + slope)
        bound.append(sign * side[r] + np.where(one, M, 0.0))
        row.append(r)
        signs.append(np.full(len(r), sign))
    return _Sides(
        sparse.csr_matrix(sparse.vstack(A)),
        np.concatenate(bound),
        np.concatenate(row),
        np.concatenate(signs),
    )


def _bounds(box: Box, free: IntArray) -> _Sides:
    eye = sparse.identity(len(box.lower), format="csr")
    high, low = free[np.isfinite(box.upper[free])], free[np.isfinite(box.lower[free])]
    none = np.full(len(high) + len(low), -1)
    return _Sides(
        sparse.csr_matrix(sparse.vstack([eye[high], -eye[low]])),
        np.append(box.upper[high], -box.lower[low]),
        none,
        np.ones(len(none)),
    )


def _balls(
    instance: Instance, free: IntArray, fixed: Array
) -> tuple[sparse.csr_matrix, Array, Array, IntArray]:
    """(radius, F x + f) of every ball as b - A v, 1 where the radius stands, and their sizes."""
    n = instance.size
    A, b, reach, sizes = [sparse.csr_matrix((0, len(fixed)))], [], [], []
    for balls in instance.balls:
        count, d = balls.f.shape
        into = (np.arange(count * d) // d) * (d + 1) + 1 + np.arange(count * d) % d
        F = sparse.coo_matrix(balls.F)
        A.append(sparse.csr_matrix((-F.data, (into[F.row], F.col)), (count * (d + 1), len(fixed))))
        values = np.zeros(count * (d + 1))
        values[into] = balls.vectors(fixed[:n]).ravel()
        values[:: d + 1] = balls.radius
        b.append(values)
        reach.append((np.arange(count * (d + 1)) % (d + 1) == 0).astype(float))
        sizes += [d + 1] * count
    return (
        sparse.csr_matrix(sparse.vstack(A))[:, free],
        np.concatenate([np.zeros(0), *b]),
        np.concatenate([np.zeros(0), *reach]),
        np.array(sizes, np.int64),
    )
