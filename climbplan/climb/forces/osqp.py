"""Force problems on inscribed pyramids by OSQP, an operator-splitting method with polishing."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from climbplan.arrays import BoolArray
from climbplan.climb.forces.pyramids import Optima
from climbplan.climb.forces.reduction import ReducedForces, ReducedHalfspaces

_TOLERANCE = 1e-6  # before polishing
_MAX_ITERATIONS = 10_000
# A first-order method crawls along the faces of a linear program: without curvature most instants
# are not solved in 20000 iterations. So these are proximal steps: the curvature is about the answer
# before, and vanishes as answers settle.
_CURVATURE = 3e-2
_PROXIMAL_STEPS = 6
_STEP_TOLERANCE = 1e-5  # change of x between proximal steps


def solve_osqp(
    group: ReducedForces, rows: ReducedHalfspaces, active: BoolArray | None = None
) -> Optima:
    """Minimise gradient . x over the rows by proximal steps, several calls per instant.

    A first-order method has no use for `active` rows. Answers that could not be polished may
    violate limits by more than the check allows.
    """
    import osqp  # a fifth of a second: only where it is asked for

    from climbplan.solvers.convex.osqp import run_osqp

    b, m, size = rows.A.shape
    P = sparse.diags(np.full(size, _CURVATURE), format="csc")
    row_norms = np.linalg.norm(rows.A, axis=-1)
    row_norms[row_norms == 0] = 1.0
    # All entries are stored, zeros as well: one sparsity pattern for the whole batch.
    indptr, indices = np.arange(size + 1) * (m + 1), np.tile(np.arange(m + 1), size)
    A = np.zeros((b, size, m + 1))
    A[:, 0, 0] = 1.0  # the bound on s
    A[:, :, 1:] = np.swapaxes(rows.A / row_norms[..., None], 1, 2)
    upper = np.concatenate([group.max_s[:, None], rows.upper / row_norms], axis=1)
    lower = np.full(m + 1, -np.inf)
    lower[0] = 0.0
    x, multipliers, solved = np.zeros((b, size)), np.zeros((b, m + 1)), np.zeros(b, bool)
    for k in range(b):
        solver = osqp.OSQP()
        solver.setup(
            P,
            group.gradient[k],
            sparse.csc_matrix((A[k].ravel(), indices, indptr), shape=(m + 1, size)),
            lower,
            upper[k],
            verbose=False,
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            max_iter=_MAX_ITERATIONS,
            polishing=True,
            adaptive_rho_interval=50,  # by iterations, not by time: the same answer every run
        )
        for _ in range(_PROXIMAL_STEPS):
            solution = run_osqp(solver, (m + 1) * size)
            if solution.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
                break
            change = float(np.abs(solution.x - x[k]).max())
            solved[k], x[k], multipliers[k] = True, solution.x, solution.y
            if change < _STEP_TOLERANCE:
                break
            solver.update(q=group.gradient[k] - _CURVATURE * x[k])
    return Optima(x, multipliers[:, 1:] > 0, solved)
