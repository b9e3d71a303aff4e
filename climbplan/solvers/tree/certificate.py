"""Prove infeasibility where a QP solver returns no multipliers of infeasible problems."""

from __future__ import annotations

from collections.abc import Iterator

import clarabel
import daqp
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.solvers.tree.choice_table import UNBOUNDED

_SOFT = 8  # DAQP's sense of a soft row
_SOFTNESS = (1e-6, 1e-9)  # tried in this order
_OPTIMAL = (1, 2, 4)
_CERTIFICATE = 1e-10


def compute_farkas_bound(
    linear: Array, M: Array, lower: Array, upper: Array, extent: Array, required_bound: float
) -> float:
    """Return a lower bound on min 1/2 |z|^2 + linear z over lower <= M z <= upper.

    With every row soft the problem has multipliers l. Their ray is inserted into the dual function
    of the hard problem: best over t of -1/2 |linear + t M'l|^2 - t l'b. Where no point is feasible,
    the bound grows without limit as the rows become harder, and along Clarabel's certificate.

    Args:
        linear: (k,) linear cost.
        M: (m, k) rows.
        lower: (m,) lower bounds of rows.
        upper: (m,) upper bounds of rows.
        extent: (k,) nonzero for coordinates without curvature, for which |z| <= extent.
        enough: Value of the bound at which the search for rays stops.
    """
    flat = np.flatnonzero(extent)
    curved = np.where(extent > 0, 0.0, linear)
    sloped_flat = flat[linear[flat] != 0]
    min_cost = -0.5 * float(curved @ curved) - float(
        extent[sloped_flat] @ np.abs(linear[sloped_flat])
    )
    best = -np.inf
    for ray in _generate_rays(M, lower, upper):
        active = np.flatnonzero(ray)
        gradient = ray[active] @ M[active]
        tilt = np.abs(gradient[flat])
        rise = -float(ray[active] @ np.where(ray[active] > 0, upper[active], lower[active]))
        rise -= float(extent[flat][tilt > 0] @ tilt[tilt > 0])
        gradient[flat] = 0.0
        gain = rise - float(curved @ gradient)
        if gain > 0:
            best = max(best, min_cost + 0.5 * gain**2 / max(float(gradient @ gradient), 1e-300))
        if best >= required_bound:
            break
    return best


def _generate_rays(M: Array, lower: Array, upper: Array) -> Iterator[Array]:
    """Yield multipliers of softened rows, then Clarabel's certificate."""
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
