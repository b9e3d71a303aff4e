"""Rows with products that are second-order cones, found by the inertia of their matrix.

With z = (x, 1) a row is z'G z <= 0. If G has one negative eigenvalue -m with eigenvector v,

    z'G z <= 0  <=>  sum_i l_i (u_i'z)^2 <= m (v'z)^2

over the positive eigenvalues l_i with eigenvectors u_i (Sylvester's law of inertia). Signs are
counted with coordinates in units of their ranges, so that eigenvalues near zero change the row by
rounding alone. Where v'z has one sign within bounds and linear rows, this is one cone
|(sqrt(l_i) u_i'z)| <= sqrt(m) v'z.
Examples are x y >= a for positive factors, and u (z + s) <= z s with u <= z, a queue of a server
that a binary z opens.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import LimitReached
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Balls, Instance, Products
from climbplan.solvers.highs.linear import LinearProgram, compute_dual_bound, solve_linear

_ZERO = 1e-14  # eigenvalue that counts as zero, relative to the largest and to their number
_SIGN = 1e-9  # value of v'z below zero that counts as rounding
_MAX_VARIABLES = 60  # of one row's products
_MAX_LIMIT = 1e3  # largest factor by which a cone is scaled


@dataclass(frozen=True)
class _ConeRow:
    """One cone |F x + f| <= slope'x + radius, scaled so that violations are those of its row."""

    F: sparse.csr_matrix  # (d, n)
    f: Array  # (d,)
    slope: sparse.csr_matrix  # (1, n)
    radius: float


def state_cones(instance: Instance) -> Instance:
    """Return the instance with cones for all rows that are cones, in the same variables.

    Products that no other row has are dropped. A point that satisfies the cones satisfies the rows,
    up to rounding, and the other way round.
    """
    if not instance.products.count:
        return instance
    box = propagate_box(instance)
    cones: dict[int, _ConeRow] = {}
    for row in np.flatnonzero(np.diff(sparse.csr_matrix(instance.Q).indptr)):
        if np.isfinite(instance.row_lower[row]) != np.isfinite(instance.row_upper[row]):
            cone = _find_cone(instance, int(row), box)
            if cone is not None:
                cones[int(row)] = cone
    if not cones:
        return instance
    is_other = np.ones(instance.A.shape[0], bool)
    is_other[list(cones)] = False
    remaining = _select_rows(instance, is_other)
    return replace(remaining, balls=(*instance.balls, *_stack_by_dimension(cones.values())))


def _find_cone(instance: Instance, row: int, box: VariableBox) -> _ConeRow | None:
    """Return a row as a cone, None where it is none."""
    index, G, remainder = _build_form(instance, row)
    if len(index) > _MAX_VARIABLES:
        return None
    coordinates = _build_coordinates(instance.size, index, remainder)
    own_units = _compute_units(coordinates, box)
    inertia = _count_signs(
        np.asarray(np.linalg.eigvalsh(own_units[:, None] * G * own_units), np.float64)
    )
    if inertia[0] != 1:
        return None
    # All units give the same inertia, where rounding allows, but other heads
    for unit in (np.ones(len(G)), own_units):
        values, vectors = np.linalg.eigh(unit[:, None] * G * unit)
        if _count_signs(values) != inertia:
            continue
        vectors = vectors / unit[:, None]
        head = np.sqrt(-values[0]) * vectors[:, 0]
        slope, radius = sparse.csr_matrix(head[None, :-1] @ coordinates), float(head[-1])
        sign = _find_sign(instance, slope, radius, box)
        if sign:
            positive = slice(len(values) - inertia[1], None)
            body = np.sqrt(values[positive])[:, None] * vectors[:, positive].T
            return _scale_cone(body, sign * slope, sign * radius, coordinates, box)
    return None


def _scale_cone(
    body: Array,
    slope: sparse.csr_matrix,
    radius: float,
    coordinates: sparse.csr_matrix,
    box: VariableBox,
) -> _ConeRow:
    """Return |body (coordinates x, 1)| <= slope'x + radius, scaled by its largest limit."""
    limit = box.interval(slope)
    reach = max(abs(float(limit.lower[0]) + radius), abs(float(limit.upper[0]) + radius))
    scale = float(np.clip(reach, 1.0, _MAX_LIMIT)) if np.isfinite(reach) else 1.0
    return _ConeRow(
        F=sparse.csr_matrix(scale * (sparse.csr_matrix(body[:, :-1]) @ coordinates)),
        f=scale * body[:, -1],
        slope=sparse.csr_matrix(scale * slope),
        radius=scale * radius,
    )


def _count_signs(values: Array) -> tuple[int, int]:
    """Return the numbers of negative and of positive eigenvalues."""
    zero = _ZERO * len(values) * float(np.abs(values).max())
    return int(np.sum(values < -zero)), int(np.sum(values > zero))


def _build_form(instance: Instance, row: int) -> tuple[IntArray, Array, sparse.csr_matrix]:
    """Return factors (k,), G over them, the other variables' sum and 1, and that sum (1, n).

    Without other variables G has no row for their sum, and the sum no entries.
    """
    upper = float(instance.row_upper[row])
    sign, end = (1.0, upper) if np.isfinite(upper) else (-1.0, -float(instance.row_lower[row]))
    q, a = sparse.csr_matrix(instance.Q)[row], sign * instance.A[row].toarray().ravel()
    first, second = instance.products.first[q.indices], instance.products.second[q.indices]
    index = np.unique(np.concatenate([first, second]))
    linear = a.copy()
    linear[index] = 0.0
    remainder = sparse.csr_matrix(linear)
    remainder.eliminate_zeros()
    k, size = len(index), len(index) + 1 + bool(remainder.nnz)
    G = np.zeros((size, size))
    i, j = np.searchsorted(index, first), np.searchsorted(index, second)
    np.add.at(G, (i, j), 0.5 * sign * q.data)
    np.add.at(G, (j, i), 0.5 * sign * q.data)
    G[:k, -1] = G[-1, :k] = 0.5 * a[index]
    if remainder.nnz:
        G[k, -1] = G[-1, k] = 0.5
    G[-1, -1] = -end
    return index, G, remainder


def _build_coordinates(n: int, index: IntArray, remainder: sparse.csr_matrix) -> sparse.csr_matrix:
    """Return the rows over x of a form's coordinates but the last."""
    k = len(index)
    factors = sparse.csr_matrix((np.ones(k), (np.arange(k), index)), shape=(k, n))
    return sparse.csr_matrix(sparse.vstack([factors, remainder]) if remainder.nnz else factors)


def _compute_units(coordinates: sparse.csr_matrix, box: VariableBox) -> Array:
    """Return the largest size of each coordinate and of the last, which is 1; 1 if not bounded."""
    reach = box.interval(coordinates)
    size = np.append(np.maximum(np.abs(reach.lower), np.abs(reach.upper)), 1.0)
    return np.where(np.isfinite(size) & (size > 0.0), size, 1.0)


def _find_sign(
    instance: Instance, slope: sparse.csr_matrix, radius: float, box: VariableBox
) -> float:
    """Return 1 where slope'x + radius is nowhere negative, -1 where nowhere positive, else 0.

    Signs rest on bounds and on multipliers of linear rows, not on what a solver says of itself.
    """
    reach = box.interval(slope)
    slack = _SIGN * max(1.0, abs(radius))
    if reach.lower[0] + radius >= -slack:
        return 1.0
    if reach.upper[0] + radius <= slack:
        return -1.0
    linear = np.diff(sparse.csr_matrix(instance.Q).indptr) == 0
    for sign in (1.0, -1.0):
        program = LinearProgram(
            cost=sign * slope.toarray().ravel(),
            lower=box.lower,
            upper=box.upper,
            A=sparse.csr_matrix(instance.A)[linear],
            row_lower=instance.row_lower[linear],
            row_upper=instance.row_upper[linear],
        )
        try:
            answer = solve_linear(program)
        except LimitReached:  # unbounded, for one
            continue
        if answer.row_dual is None:
            continue
        if compute_dual_bound(program, answer.row_dual) + sign * radius >= -slack:
            return sign
    return 0.0


def _select_rows(instance: Instance, selected: BoolArray) -> Instance:
    """Return the instance with a mask of its rows, and with the products that these have."""
    Q = sparse.csr_matrix(instance.Q)[selected]
    implied = sparse.csr_matrix(instance.implications.Q)
    occurs = np.zeros(instance.products.count, bool)
    occurs[np.concatenate([Q.indices, implied.indices])] = True
    return replace(
        instance,
        A=sparse.csr_matrix(instance.A)[selected],
        row_lower=instance.row_lower[selected],
        row_upper=instance.row_upper[selected],
        Q=Q[:, occurs],
        products=Products(instance.products.first[occurs], instance.products.second[occurs]),
        implications=replace(instance.implications, Q=implied[:, occurs]),
    )


def _stack_by_dimension(cones: Iterable[_ConeRow]) -> Iterator[Balls]:
    """Yield all cones, those of one dimension together, equal ones once."""
    groups: dict[int, dict[bytes, _ConeRow]] = {}
    for cone in cones:
        entries = [cone.F.indices, cone.F.data, cone.f, cone.slope.indices, cone.slope.data]
        key = b"|".join(array.tobytes() for array in (*entries, np.array([cone.radius])))
        groups.setdefault(len(cone.f), {}).setdefault(key, cone)
    for group in groups.values():
        yield Balls(
            F=sparse.vstack([cone.F for cone in group.values()]).tocsr(),
            f=np.stack([cone.f for cone in group.values()]),
            radius=np.array([cone.radius for cone in group.values()]),
            slope=sparse.vstack([cone.slope for cone in group.values()]).tocsr(),
        )
