"""Force problems on inscribed pyramids by DAQP, a dual active-set method for small dense QPs."""

from __future__ import annotations

import daqp
import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.forces.pyramids import Optima
from climbplan.climb.forces.reduction import ReducedForces, ReducedHalfspaces

_UNBOUNDED = -1e30  # no lower bound, in DAQP's terms
_PRIMAL_TOLERANCE = 1e-10  # on rows of unit length
_SOLVED = 1


def solve_daqp(
    group: ReducedForces, rows: ReducedHalfspaces, active: BoolArray | None = None
) -> Optima:
    """Minimise a group's objective and preference over the rows, one call per instant.

    Args:
        group: The reduced problems of B instants.
        rows: Their linear rows.
        active: (B, m) bool, rows that are active at the start; None starts each instant from the
            rows that were active in the previous one.
    """
    b, m, size = rows.A.shape
    gradient = group.gradient + group.preference_gradient
    upper = np.empty((b, m + 1))  # the bound on s comes first
    upper[:, 0], upper[:, 1:] = group.max_s, rows.upper
    lower = np.full(m + 1, _UNBOUNDED)
    lower[0] = 0.0
    x, multipliers = np.empty((b, size)), np.empty((b, m + 1))
    solved = np.zeros(b, bool)
    initial_sense = np.zeros((b, m + 1), np.int32)
    if active is not None:
        initial_sense[:, 1:] = active
    sense = initial_sense[0]
    for k in range(b):
        if active is not None:
            sense = initial_sense[k]
        solution, _, flag, info = daqp.solve(
            group.preference[k],
            gradient[k],
            rows.A[k],
            upper[k],
            lower,
            sense,
            primal_tol=_PRIMAL_TOLERANCE,
        )
        x[k], multipliers[k], solved[k] = solution, info["lam"], flag == _SOLVED
        if active is None:
            sense = (multipliers[k] > 0).astype(np.int32) if solved[k] else initial_sense[0]
    return Optima(x, multipliers[:, 1:] > 0, solved)
