"""A linear relaxation of one posture that is exact but for torsion.

A point contact p with force f inside a patch is replaced by forces in the cone at every corner of
the patch, weights and forces multiplied out: p_i x f_i = sum_u v_u x g_u with g_u in the cone. The
cone is convex, so the sum f = sum g_u is in it, and the centre of pressure lies in the patch. What
is gained beside P is a moment about the normal there, at most mu f_n times the patch's size. So the
relaxation is tight on small patches; an infeasible one proves P infeasible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import INSCRIBED, Legs, build_ball_directions
from climbplan.climb.envelopes.statement import COM_RANGE, FACETS, ROTATION_LIMIT
from climbplan.climb.envelopes.terrains import CORNERS, LimbPatches
from climbplan.mechanics.friction import contact_frame, regular_corners
from climbplan.solvers.highs.linear import LinearProgram, solve_linear

DIRECTIONS = build_ball_directions()


@dataclass(frozen=True)
class Relaxed:
    """A solution of the relaxation."""

    com: Array  # (3,) [P]
    rpy: Array  # (3,) [rad]
    pressure: Array  # (N, 3) centre of pressure, world [P]; the weights' point without force
    force: Array  # (N, 3) [weights]
    torsion: Array  # (N,) moment about the centre of pressure beyond that of a point, absolute


def compute_generators(patches: LimbPatches) -> Array:
    """Return edges of the inscribed pyramids with unit normal part, (N, FACETS, 3)."""
    frame = contact_frame(patches.normal)
    angle = regular_corners(FACETS)
    around = (
        np.cos(angle)[:, None] * frame.tangent[:, None]
        + np.sin(angle)[:, None] * frame.bitangent[:, None]
    )
    return np.asarray(frame.normal[:, None] + patches.friction[:, None, None] * around)


def solve_relaxed(
    legs: Legs, patches: LimbPatches, force: Array, moment: Array, corners: Array | None = None
) -> Relaxed | None:
    """Return the relaxation with least friction used, None if it has no solution.

    corners: (N, 4, 3) parts of the patches [P], the patches themselves if left out.
    force, moment: (3,) external, about the body origin.
    """
    n = legs.count
    vertex = patches.vertices / legs.length if corners is None else corners
    edge = compute_generators(patches)
    program, layout = _build_program(legs, patches, force, moment, vertex, edge)
    x = solve_linear(program).x
    if x is None:
        return None
    w = x[layout.pressed].reshape(n, CORNERS, FACETS)
    at_corner = np.einsum("iue,iek->iuk", w, edge)
    total = at_corner.sum(axis=1)
    pressure = w.sum(axis=2)
    weights = x[layout.weight].reshape(n, CORNERS)
    loaded = pressure.sum(axis=1) > 1e-9
    weights[loaded] = pressure[loaded] / pressure[loaded].sum(axis=1, keepdims=True)
    center = np.einsum("iu,iuk->ik", weights, vertex)
    residual_moment = np.cross(vertex, at_corner).sum(axis=1) - np.cross(center, total)
    return Relaxed(
        x[layout.com], x[layout.rpy], center, total, np.linalg.norm(residual_moment, axis=1)
    )


@dataclass(frozen=True)
class _ColumnSlices:
    com: slice
    rpy: slice
    weight: slice
    pressed: slice
    size: int


def _build_layout(n: int) -> _ColumnSlices:
    weight = 6 + CORNERS * n
    size = weight + CORNERS * FACETS * n
    return _ColumnSlices(slice(0, 3), slice(3, 6), slice(6, weight), slice(weight, size), size)


_Rows = tuple[Array, Array, Array]  # matrix (R, C), lower and upper bounds (R,)


def _build_program(
    legs: Legs, patches: LimbPatches, force: Array, moment: Array, vertex: Array, edge: Array
) -> tuple[LinearProgram, _ColumnSlices]:
    """Build the linear program of postures whose limbs balance force and moment."""
    columns = _build_layout(legs.count)
    rows = [
        _build_balance_rows(columns, force, moment, vertex, edge),
        *_build_force_rows(columns, edge),
        *_build_workspace_rows(legs, columns, vertex),
    ]
    A, lower, upper = (np.concatenate(v) for v in zip(*rows, strict=True))
    low, high = np.zeros(columns.size), np.full(columns.size, 1.0)
    low[columns.com], high[columns.com] = -COM_RANGE, COM_RANGE
    low[columns.rpy], high[columns.rpy] = -ROTATION_LIMIT, ROTATION_LIMIT
    high[columns.pressed] = np.inf
    # Little friction in use means little torsion
    cost = np.zeros(columns.size)
    cost[columns.pressed] = np.repeat(patches.friction, CORNERS * FACETS)
    return LinearProgram(cost, low, high, sparse.csr_matrix(A), lower, upper), columns


def _bound_rows(matrix: Array, low: Array | float, high: Array | float) -> _Rows:
    """Return rows with a bound for each of them."""
    lower, upper = (np.broadcast_to(np.asarray(v, float), len(matrix)) for v in (low, high))
    return matrix, lower, upper


def _build_balance_rows(
    columns: _ColumnSlices, force: Array, moment: Array, vertex: Array, edge: Array
) -> _Rows:
    """Balance forces and moments about the point of reference: com x force + moment + sum = 0."""
    M = np.zeros((6, columns.size))
    M[:3, columns.pressed] = (
        np.broadcast_to(edge[:, None], (len(edge), CORNERS, FACETS, 3)).reshape(-1, 3).T
    )
    M[3:, columns.pressed] = np.cross(vertex[:, :, None], edge[:, None]).reshape(-1, 3).T
    M[3:, columns.com] = -_build_skew_matrix(force)
    load = np.concatenate([-force, -moment])
    return _bound_rows(M, load, load)


def _build_force_rows(columns: _ColumnSlices, edge: Array) -> Iterator[_Rows]:
    """Yield the rows of corner weights, and of forces pressed at weighted corners."""
    n, num_generators = len(edge), CORNERS * FACETS
    M = np.zeros((n, columns.size))
    for i in range(n):
        M[i, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = 1.0
    yield _bound_rows(M, 1.0, 1.0)
    # A corner's pressure is weight times the limb's: envelopes on [0, 1] x [0, 1]
    M = np.zeros((2, n, CORNERS, columns.size))
    for i in range(n):
        first = columns.weight.stop + num_generators * i
        M[1, i, :, first : first + num_generators] -= 1.0
        for u in range(CORNERS):
            M[0, i, u, first + FACETS * u : first + FACETS * (u + 1)] = 1.0
            M[0, i, u, 6 + CORNERS * i + u] = -1.0
            M[1, i, u, first + FACETS * u : first + FACETS * (u + 1)] += 1.0
            M[1, i, u, 6 + CORNERS * i + u] = -1.0
    yield _bound_rows(M[0].reshape(-1, columns.size), -np.inf, 0.0)
    yield _bound_rows(M[1].reshape(-1, columns.size), -1.0, np.inf)
    # Forces within [-1, 1] in each component
    M = np.zeros((n, 3, columns.size))
    for i in range(n):
        first = columns.weight.stop + num_generators * i
        M[i, :, first : first + num_generators] = np.tile(edge[i], (CORNERS, 1)).T
    yield _bound_rows(M.reshape(-1, columns.size), -1.0, 1.0)


def _build_workspace_rows(legs: Legs, columns: _ColumnSlices, vertex: Array) -> Iterator[_Rows]:
    """Yield the rows of workspaces, d . (p - c - v - rpy x v) <= r, and of the reference's."""
    n = legs.count
    for origin, radius in ((legs.shoulder, legs.reach), (legs.stance, legs.stance_radius)):
        v = origin / legs.length
        M = np.zeros((n, len(DIRECTIONS), columns.size))
        for i in range(n):
            M[i, :, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = DIRECTIONS @ vertex[i].T
            M[i, :, columns.com] = -DIRECTIONS
            M[i, :, columns.rpy] = -np.cross(v[i], DIRECTIONS)
        limit = radius * INSCRIBED / legs.length + v @ DIRECTIONS.T
        yield _bound_rows(M.reshape(-1, columns.size), -np.inf, limit.ravel())
    # Toes within P of the point of reference, along each axis
    M = np.zeros((n, 3, columns.size))
    for i in range(n):
        M[i, :, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = vertex[i].T
    yield _bound_rows(M.reshape(-1, columns.size), -1.0, 1.0)


def _build_skew_matrix(v: Array) -> Array:
    """Return the matrix of c -> v x c."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
