"""A linear relaxation of one posture that is exact but for torsion.

A point contact p with force f inside a patch is replaced by forces in the cone at every corner of
the patch, weights and forces multiplied out: p_i x f_i = sum_u v_u x g_u with g_u in the cone. The
cone is convex, so the sum f = sum g_u is in it, and the centre of pressure lies in the patch. What
is gained beside P is a moment about the normal there, at most mu f_n times the patch's size. So the
relaxation is tight on small patches; an infeasible one proves P infeasible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import INSCRIBED, Legs, ball_directions
from climbplan.climb.envelopes.statement import COM_RANGE, FACETS, ROTATION_LIMIT
from climbplan.climb.envelopes.terrains import CORNERS, Patches
from climbplan.mechanics.friction import contact_frame, regular_corners
from climbplan.solvers.highs.linear import LinearProgram, solve_linear

DIRECTIONS = ball_directions()


@dataclass(frozen=True)
class Relaxed:
    """A solution of the relaxation."""

    com: Array  # (3,) [P]
    rpy: Array  # (3,) [rad]
    pressure: Array  # (N, 3) centre of pressure, world [P]; the weights' point without force
    force: Array  # (N, 3) [weights]
    torsion: Array  # (N,) moment about the centre of pressure beyond that of a point, absolute


def generators(patches: Patches) -> Array:
    """Edges of the inscribed pyramids with unit normal part, (N, FACETS, 3)."""
    frame = contact_frame(patches.normal)
    angle = regular_corners(FACETS)
    around = (
        np.cos(angle)[:, None] * frame.tangent[:, None]
        + np.sin(angle)[:, None] * frame.bitangent[:, None]
    )
    return np.asarray(frame.normal[:, None] + patches.friction[:, None, None] * around)


def solve_relaxed(
    legs: Legs, patches: Patches, force: Array, moment: Array, corners: Array | None = None
) -> Relaxed | None:
    """The relaxation with least friction used, None if it has no solution.

    corners: (N, 4, 3) parts of the patches [P], the patches themselves if left out.
    force, moment: (3,) external, about the body origin.
    """
    n = legs.count
    vertex = patches.vertices / legs.length if corners is None else corners
    edge = generators(patches)
    program, layout = _program(legs, patches, force, moment, vertex, edge)
    x = solve_linear(program).x
    if x is None:
        return None
    w = x[layout.pressed].reshape(n, CORNERS, FACETS)
    at_corner = np.einsum("iue,iek->iuk", w, edge)
    total = at_corner.sum(axis=1)
    pressure = w.sum(axis=2)
    share = x[layout.weight].reshape(n, CORNERS)
    loaded = pressure.sum(axis=1) > 1e-9
    share[loaded] = pressure[loaded] / pressure[loaded].sum(axis=1, keepdims=True)
    center = np.einsum("iu,iuk->ik", share, vertex)
    rest = np.cross(vertex, at_corner).sum(axis=1) - np.cross(center, total)
    return Relaxed(x[layout.com], x[layout.rpy], center, total, np.linalg.norm(rest, axis=1))


@dataclass(frozen=True)
class _Layout:
    com: slice
    rpy: slice
    weight: slice
    pressed: slice
    size: int


def _layout(n: int) -> _Layout:
    weight = 6 + CORNERS * n
    size = weight + CORNERS * FACETS * n
    return _Layout(slice(0, 3), slice(3, 6), slice(6, weight), slice(weight, size), size)


def _program(
    legs: Legs, patches: Patches, force: Array, moment: Array, vertex: Array, edge: Array
) -> tuple[LinearProgram, _Layout]:
    n = legs.count
    at = _layout(n)
    per = CORNERS * FACETS
    A: list[Array] = []
    lower: list[Array] = []
    upper: list[Array] = []

    def rows(matrix: Array, low: Array | float, high: Array | float) -> None:
        A.append(matrix)
        lower.append(np.broadcast_to(np.asarray(low, float), len(matrix)))
        upper.append(np.broadcast_to(np.asarray(high, float), len(matrix)))

    # Balance of forces and of moments about the point of reference: com x force + moment + sum = 0
    M = np.zeros((6, at.size))
    M[:3, at.pressed] = np.broadcast_to(edge[:, None], (n, CORNERS, FACETS, 3)).reshape(-1, 3).T
    M[3:, at.pressed] = np.cross(vertex[:, :, None], edge[:, None]).reshape(-1, 3).T
    M[3:, at.com] = -_skew(force)
    rows(M, np.concatenate([-force, -moment]), np.concatenate([-force, -moment]))
    M = np.zeros((n, at.size))
    for i in range(n):
        M[i, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = 1.0
    rows(M, 1.0, 1.0)
    # A corner's pressure is weight times the limb's: envelopes on [0, 1] x [0, 1]
    M = np.zeros((2, n, CORNERS, at.size))
    for i in range(n):
        first = at.weight.stop + per * i
        M[1, i, :, first : first + per] -= 1.0
        for u in range(CORNERS):
            M[0, i, u, first + FACETS * u : first + FACETS * (u + 1)] = 1.0
            M[0, i, u, 6 + CORNERS * i + u] = -1.0
            M[1, i, u, first + FACETS * u : first + FACETS * (u + 1)] += 1.0
            M[1, i, u, 6 + CORNERS * i + u] = -1.0
    rows(M[0].reshape(-1, at.size), -np.inf, 0.0)
    rows(M[1].reshape(-1, at.size), -1.0, np.inf)
    # Forces within [-1, 1] in each component
    M = np.zeros((n, 3, at.size))
    for i in range(n):
        first = at.weight.stop + per * i
        M[i, :, first : first + per] = np.tile(edge[i], (CORNERS, 1)).T
    rows(M.reshape(-1, at.size), -1.0, 1.0)
    # Workspaces: d . (p - c - v - rpy x v) <= r
    for origin, radius in ((legs.shoulder, legs.reach), (legs.stance, legs.stance_radius)):
        v = origin / legs.length
        M = np.zeros((n, len(DIRECTIONS), at.size))
        for i in range(n):
            M[i, :, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = DIRECTIONS @ vertex[i].T
            M[i, :, at.com] = -DIRECTIONS
            M[i, :, at.rpy] = -np.cross(v[i], DIRECTIONS)
        limit = radius * INSCRIBED / legs.length + v @ DIRECTIONS.T
        rows(M.reshape(-1, at.size), -np.inf, limit.ravel())
    # Toes within P of the point of reference, along each axis
    M = np.zeros((n, 3, at.size))
    for i in range(n):
        M[i, :, 6 + CORNERS * i : 6 + CORNERS * (i + 1)] = vertex[i].T
    rows(M.reshape(-1, at.size), -1.0, 1.0)

    low, high = np.zeros(at.size), np.full(at.size, 1.0)
    low[at.com], high[at.com] = -COM_RANGE, COM_RANGE
    low[at.rpy], high[at.rpy] = -ROTATION_LIMIT, ROTATION_LIMIT
    high[at.pressed] = np.inf
    # Little friction in use means little torsion
    cost = np.zeros(at.size)
    cost[at.pressed] = np.repeat(patches.friction, per)
    program = LinearProgram(
        cost,
        low,
        high,
        sparse.csr_matrix(np.vstack(A)),
        np.concatenate(lower),
        np.concatenate(upper),
    )
    return program, at


def _skew(v: Array) -> Array:
    """The matrix of c -> v x c."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
