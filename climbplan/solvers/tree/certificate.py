"""Proofs of infeasibility from a QP solver that gives no multipliers for infeasible problems."""

from __future__ import annotations

from collections.abc import Iterator

import clarabel
import daqp
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.solvers.tree.choice_table import UNBOUNDED

_SOFT = 8  # DAQP's sense of a row that may be violated at a price
_SOFTNESS = (1e-6, 1e-9)  # tried in turn
_OPTIMAL = (1, 2, 4)
_CERTIFICATE = 1e-10


def proved_bound(
    linear: Array, M: Array, lower: Array, upper: Array, extent: Array, enough: float
) -> float:
    """A lower bound on min 1/2 |z|^2 + linear z over lower <= M z <= upper, large if infeasible.

    With every row soft the problem has multipliers l, whose ray is tried in the dual function of
    the hard problem: best over t of -1/2 |linear + t M'l|^2 - t l'b. Where no point is feasible the
    bound grows without limit as the rows get harder, and along Clarabel's certificate. It is
    returned once it is `enough`.

    extent: (k,) not zero for coordinates without curvature, which have |z| <= extent instead.
    """
    flat = np.flatnonzero(extent)
    curved = np.where(extent > 0, 0.0, linear)
    sloped = flat[linear[flat] != 0]
    least = -0.5 * float(curved @ curved) - float(extent[sloped] @ np.abs(linear[sloped]))
    best = -np.inf
    for ray in _rays(M, lower, upper):
        held = np.flatnonzero(ray)
        pull = ray[held] @ M[held]
        tilt = np.abs(pull[flat])
        rise = -float(ray[held] @ np.where(ray[held] > 0, upper[held], lower[held]))
        rise -= float(extent[flat][tilt > 0] @ tilt[tilt > 0])
        pull[flat] = 0.0
        gain = rise - float(curved @ pull)
        if gain > 0:
            best = max(best, least + 0.5 * gain**2 / max(float(pull @ pull), 1e-300))
        if best >= enough:
            break
    return best


def _rays(M: Array, lower: Array, upper: Array) -> Iterator[Array]:
    """Multipliers of softened rows, then Clarabel's certificate."""
    k = M.shape[1]
    sense = np.full(len(M), _SOFT, np.int32)
    for softness in _SOFTNESS:
        _, _, flag, info = daqp.solve(
            np.eye(k), np.zeros(k), M, upper, lower, sense, rho_soft=softness, eq_reduction=-1
        )
        if flag in _OPTIMAL:
            yield info["lam"]
    high, low = np.flatnonzero(upper < UNBOUNDED), np.flatnonzero(lower > -UNBOUNDED)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_infeas_abs = settings.tol_infeas_rel = _CERTIFICATE
    solution = clarabel.DefaultSolver(
        sparse.identity(k, format="csc"),
        np.zeros(k),
        sparse.csc_matrix(np.vstack([M[high], -M[low]])),
        np.concatenate([upper[high], -lower[low]]),
        [clarabel.NonnegativeConeT(len(high) + len(low))],
        settings,
    ).solve()
    if solution.status == clarabel.SolverStatus.PrimalInfeasible:
        multiplier = np.array(solution.z)
        ray = np.zeros(len(M))
        ray[high] = multiplier[: len(high)]
        ray[low] -= multiplier[len(high) :]
        yield ray
