"""Compute multipliers of a leaf with Clarabel, from its relaxation or its elastic program.

Both are programs over the rows in which certificates are checked: indicator rows whose binary is
open get big-M terms, and products have their envelopes. The elastic program minimises t >= 0 such
that some v satisfies every row and every ball within t. Where its optimum is positive, its
multipliers prove that the leaf is infeasible, with the margin t.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import CertificateBox
from climbplan.certificates.rows import CertificateRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.multiplier_map import Multipliers

_FIXED = 1e-10  # relative width of a range at which a variable counts as fixed
_ACCURACY = 1e-10

_INFEASIBLE = (
    clarabel.SolverStatus.PrimalInfeasible,
    clarabel.SolverStatus.AlmostPrimalInfeasible,
)


class RelaxationSolution(NamedTuple):
    """Multipliers and solution of a relaxation."""

    multipliers: Multipliers
    v: Array  # (N,)


@dataclass(frozen=True)
class _InequalityRows:
    """Rows A v <= b, or A v = b."""

    A: sparse.csr_matrix  # (m, N)
    b: Array
    row: IntArray  # (m,) index of the stated row, -1 for a bound
    sign: Array  # (m,) 1 for an upper side and for an equation, -1 for a lower side


class _FreeRows(NamedTuple):
    """Rows over the free variables: equations, inequalities and bounds, without empty ones."""

    equations: _InequalityRows
    inequalities: _InequalityRows
    bounds: _InequalityRows


class _LeafProgram(NamedTuple):
    """Minimise 1/2 x'P x + q'x subject to A x + s = b with s in a product of cones."""

    P: sparse.csc_matrix
    q: Array
    A: sparse.spmatrix
    b: Array
    cones: list[Any]


def compute_leaf_multipliers(
    instance: Instance, rows: CertificateRows, box: CertificateBox, empty: bool
) -> RelaxationSolution | None:
    """Compute the multipliers of a leaf from its relaxation, or from its elastic program.

    Args:
        instance: The stated instance.
        rows: Its rows, including the planes of the leaf's box.
        box: Ranges of the leaf.
        empty: Whether to solve the elastic program, which proves infeasibility.

    Returns:
        None where the solver fails, or no variable is free and all balls hold. The multipliers
        have no point where they prove that the relaxation is infeasible.
    """
    width = box.upper - box.lower
    free = np.flatnonzero(width > _FIXED * np.maximum(1.0, np.abs(box.lower)))
    is_bounded = np.isfinite(width)
    fixed = np.zeros(len(width))
    fixed[is_bounded] = 0.5 * (box.lower[is_bounded] + box.upper[is_bounded])
    if not len(free):
        return _refute_point(instance, fixed, len(rows.lower))
    fixed[free] = 0.0
    equal = np.zeros(len(rows.lower), bool) if empty else _find_equations(rows, box)
    blocks = _FreeRows(
        _substitute_fixed(_build_equations(rows, equal), free, fixed),
        _substitute_fixed(_build_inequalities(rows, box, ~equal), free, fixed),
        _substitute_fixed(_build_bounds(box, free), free, fixed),
    )
    F, f, radius_mask, lengths = _build_balls(instance, free, fixed)
    A = sparse.vstack([*(block.A for block in blocks), F])
    b = np.concatenate([*(block.b for block in blocks), f])
    cones = [clarabel.ZeroConeT(len(blocks.equations.b))] if len(blocks.equations.b) else []
    if inequalities := len(blocks.inequalities.b) + len(blocks.bounds.b):
        cones.append(clarabel.NonnegativeConeT(inequalities))
    cones += [clarabel.SecondOrderConeT(int(length)) for length in lengths]
    if empty:
        program = _build_elastic_program(blocks, A, b, cones, radius_mask)
    else:
        program = _LeafProgram(*_restrict_cost(instance, free, fixed), A, b, cones)
    solution = _solve_conic(program)
    if solution is None:
        return None
    x, z, infeasible = solution
    z = z[1:] if empty else z
    y, offset = np.zeros(len(rows.lower)), 0
    for block in (blocks.equations, blocks.inequalities):
        np.add.at(y, block.row, -block.sign * z[offset : offset + len(block.b)])
        offset += len(block.b)
    offset += len(blocks.bounds.b)
    vector_rows = np.flatnonzero(radius_mask == 0.0)  # behind each ball's radius its coordinates
    ball = -z[offset:][vector_rows]
    if len(ball):
        begin = len(rows.lower) - 4 * len(rows.w) - len(ball)
        y[begin : begin + len(ball)] += _find_excess(instance, z[offset:], lengths)
    v = fixed.copy()
    v[free] = np.clip(x[: len(free)], box.lower[free], box.upper[free])
    point = None if empty or infeasible else v[: instance.size]
    return RelaxationSolution(Multipliers(point, y, ball), v)


def _find_excess(instance: Instance, z: Array, lengths: IntArray) -> Array:
    """Return (D,) what a cone's multiplier of its radius exceeds that of its vector by.

    It belongs to the row that the radius is not negative, in place of the cone's first coordinate.
    """
    begin = np.cumsum(lengths) - lengths  # of each cone: its radius
    vectors = z.copy()
    vectors[begin] = 0.0
    excess = np.maximum(z[begin] - np.sqrt(np.add.reduceat(vectors**2, begin)), 0.0)
    is_cone = np.concatenate(
        [np.full(balls.count, balls.slope is not None) for balls in instance.balls]
    )
    first = begin - np.arange(len(lengths))  # without the radii before
    total = np.zeros(int((lengths - 1).sum()))
    total[first[is_cone]] = excess[is_cone]
    return total


def _refute_point(instance: Instance, v: Array, num_rows: int) -> RelaxationSolution | None:
    """Return multipliers of the most violated ball at v (N,), None where every ball holds.

    With the unit vector u of F x + f, the ball implies u'(F x + f) <= radius + slope'x.
    """
    blocks: list[Array] = []
    worst, begin, size = 0.0, 0, 0
    for balls in instance.balls:
        vectors, x = balls.vectors(v[: instance.size]), v[: instance.size]
        lengths = np.linalg.norm(vectors, axis=1)
        units = vectors / np.maximum(lengths, np.finfo(float).tiny)[:, None]
        excess = lengths - balls.limits(x)
        k, d = int(np.argmax(excess)), vectors.shape[1]
        if excess[k] > worst:
            worst, begin, size = float(excess[k]), sum(len(block) for block in blocks) + k * d, d
        blocks.append(units.ravel())
    if worst == 0.0:
        return None
    ball = np.concatenate(blocks)
    is_other = np.ones(len(ball), bool)
    is_other[begin : begin + size] = False
    ball[is_other] = 0.0
    return RelaxationSolution(Multipliers(None, np.zeros(num_rows), ball), v)


def _substitute_fixed(rows: _InequalityRows, free: IntArray, fixed: Array) -> _InequalityRows:
    """Substitute the fixed variables into rows over all (N,), and drop rows without free ones."""
    A = rows.A[:, free]
    nonempty = np.flatnonzero(np.diff(A.indptr))
    b = (rows.b - rows.A @ fixed)[nonempty]
    return _InequalityRows(A[nonempty], b, rows.row[nonempty], rows.sign[nonempty])


def _restrict_cost(
    instance: Instance, free: IntArray, fixed: Array
) -> tuple[sparse.csc_matrix, Array]:
    """Return Hessian and slope of the cost over the free ones of N variables, others fixed."""
    n, size = instance.size, len(fixed)
    P = sparse.block_diag([instance.P, sparse.csc_matrix((size - n, size - n))], format="csc")
    q = np.zeros(size)
    q[:n] = instance.q
    q += P @ fixed
    return sparse.csc_matrix(P[free][:, free]), q[free]


def _build_elastic_program(
    blocks: _FreeRows, A: sparse.spmatrix, b: Array, cones: list[Any], radius_mask: Array
) -> _LeafProgram:
    """Build: minimise t >= 0 such that inequalities and balls, all of A x + s = b, hold within t.

    Equations and bounds hold exactly. The first row is t >= 0, the last variable is t.
    """
    k = A.shape[1]
    column = np.concatenate(
        [
            np.zeros(len(blocks.equations.b)),
            np.full(len(blocks.inequalities.b), -1.0),
            np.zeros(len(blocks.bounds.b)),
            -radius_mask,
        ]
    )
    positive = sparse.csr_matrix(([-1.0], ([0], [k])), (1, k + 1))
    return _LeafProgram(
        P=sparse.csc_matrix((k + 1, k + 1)),
        q=np.append(np.zeros(k), 1.0),
        A=sparse.vstack([positive, sparse.hstack([A, column[:, None]])]),
        b=np.append(0.0, b),
        cones=[clarabel.NonnegativeConeT(1), *cones],
    )


def _solve_conic(program: _LeafProgram) -> tuple[Array, Array, bool] | None:
    """Solve the conic program; return point, multipliers and whether it is infeasible."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    settings.tol_infeas_abs = settings.tol_infeas_rel = _ACCURACY
    upper, A = sparse.csc_matrix(sparse.triu(program.P)), sparse.csc_matrix(program.A)
    solver = clarabel.DefaultSolver(upper, program.q, A, program.b, program.cones, settings)
    solution = solver.solve()
    x, z = np.array(solution.x), np.array(solution.z)
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        return None
    return x, z, solution.status in _INFEASIBLE


def _find_equations(rows: CertificateRows, box: CertificateBox) -> Any:
    """Return (rows,) mask of rows that are equations and have to hold."""
    return box.classify_rows(rows)[0] & (rows.lower == rows.upper)


def _build_equations(rows: CertificateRows, equal: Any) -> _InequalityRows:
    """Build the equations of rows."""
    r = np.flatnonzero(equal)
    return _InequalityRows(rows.G[r], rows.upper[r], r, np.ones(len(r)))


def _build_inequalities(rows: CertificateRows, box: CertificateBox, mask: Any) -> _InequalityRows:
    """Build rows that are active, and big-M rows of those whose binary is open."""
    b, (is_active, is_open) = rows.binary, box.classify_rows(rows)
    A, bound, row, sign_blocks = [], [], [], []
    for sign, side in ((1.0, rows.upper), (-1.0, rows.lower)):
        r = np.flatnonzero(mask & np.isfinite(side) & (is_active | is_open))
        G = sparse.csr_matrix(sign * rows.G[r])
        ends = G.data * np.stack([box.lower, box.upper])[:, G.indices]
        row_of_entry = np.repeat(np.arange(len(r)), np.diff(G.indptr))
        max_activity = np.bincount(row_of_entry, ends.max(axis=0), len(r))
        M = np.where(is_active[r], 0.0, np.maximum(max_activity - sign * side[r], 0.0))
        is_finite = np.isfinite(M)
        r, G, M = r[is_finite], G[is_finite], M[is_finite]
        is_one = rows.value[r] == 1
        slope = sparse.csr_matrix(
            (np.where(is_one, M, -M), (np.arange(len(r)), np.maximum(b[r], 0))), G.shape
        )
        slope.eliminate_zeros()
        A.append(G + slope)
        bound.append(sign * side[r] + np.where(is_one, M, 0.0))
        row.append(r)
        sign_blocks.append(np.full(len(r), sign))
    return _InequalityRows(
        sparse.csr_matrix(sparse.vstack(A)),
        np.concatenate(bound),
        np.concatenate(row),
        np.concatenate(sign_blocks),
    )


def _build_bounds(box: CertificateBox, free: IntArray) -> _InequalityRows:
    """Build the bounds of free variables."""
    eye = sparse.identity(len(box.lower), format="csr")
    high, low = free[np.isfinite(box.upper[free])], free[np.isfinite(box.lower[free])]
    no_row = np.full(len(high) + len(low), -1)
    return _InequalityRows(
        sparse.csr_matrix(sparse.vstack([eye[high], -eye[low]])),
        np.append(box.upper[high], -box.lower[low]),
        no_row,
        np.ones(len(no_row)),
    )


def _build_balls(
    instance: Instance, free: IntArray, fixed: Array
) -> tuple[sparse.csr_matrix, Array, Array, IntArray]:
    """Build (radius + slope x, F x + f) of every ball as b - A v.

    Returns:
        A, b, a mask of the rows of radii, and the cone dimension of each ball.
    """
    n = instance.size
    A, b, radius_mask, sizes = [sparse.csr_matrix((0, len(fixed)))], [], [], []
    for balls in instance.balls:
        count, d = balls.f.shape
        vector_rows = (np.arange(count * d) // d) * (d + 1) + 1 + np.arange(count * d) % d
        F = sparse.coo_matrix(balls.F)
        shape = (count * (d + 1), len(fixed))
        block = sparse.csr_matrix((-F.data, (vector_rows[F.row], F.col)), shape)
        if balls.slope is not None:
            G = sparse.coo_matrix(balls.slope)
            block += sparse.csr_matrix((-G.data, (G.row * (d + 1), G.col)), shape)
        A.append(block)
        values = np.zeros(count * (d + 1))
        values[vector_rows] = balls.vectors(fixed[:n]).ravel()
        values[:: d + 1] = balls.limits(fixed[:n])
        b.append(values)
        radius_mask.append((np.arange(count * (d + 1)) % (d + 1) == 0).astype(float))
        sizes += [d + 1] * count
    return (
        sparse.csr_matrix(sparse.vstack(A))[:, free],
        np.concatenate([np.zeros(0), *b]),
        np.concatenate([np.zeros(0), *radius_mask]),
        np.array(sizes, np.int64),
    )
