"""Convex quadratic programs by OSQP, the operator-splitting method of the published results.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import io
import signal
import time
from contextlib import redirect_stdout
from typing import Any

import numpy as np
import osqp
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance
from climbplan.solvers.interruption import run_uninterruptible
from climbplan.solvers.result import Answer
from climbplan.solvers.weak_duality import compute_dual_bound

_ITERATIONS = 10_000
_TOLERANCE = 1e-7  # before polishing
_MIN_SCALE = 1e-12  # smallest scale of the cost
_MIN_WIDTH = 1e-6  # smallest width by which a variable is scaled
_SOLVED = (osqp.SolverStatus.OSQP_SOLVED, osqp.SolverStatus.OSQP_SOLVED_INACCURATE)
_INFEASIBLE = osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE


class OsqpSession:
    """Solves convex quadratic programs in turn with OSQP, from the last iterate.

    The factorisation is kept while the matrices are the same. Variables are scaled by the width of
    their box and rows to unit length, since a first-order method converges slowly with mixed units.
    """

    def __init__(self, iterations: int = _ITERATIONS, tolerance: float = _TOLERANCE) -> None:
        self._iterations, self._tolerance = iterations, tolerance
        self._width: Array = np.zeros(0)
        self._solver: osqp.OSQP | None = None
        self._P = sparse.csc_matrix((0, 0))
        self._A = sparse.csc_matrix((0, 0))

    def solve(self, instance: Instance) -> Answer:
        """Solve an instance without balls; rows come first, then the variables' bounds.

        Raises:
            UsageError: The instance has balls.
        """
        if "balls" in instance.features:
            raise UsageError("OSQP has no second-order cones: use clarabel")
        begin = time.perf_counter()
        if len(self._width) != instance.size:
            self._width = _compute_widths(instance)
        D = sparse.diags(self._width)
        rows = sparse.vstack([instance.A, sparse.identity(instance.size)]) @ D
        length = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        length[length == 0] = 1.0
        A = (sparse.diags(1.0 / length) @ rows).tocsc()
        P = sparse.triu(D @ instance.P @ D, format="csc")
        q = instance.q * self._width
        steepness = max(np.abs(P.data).max(initial=0.0), np.abs(q).max(initial=0.0), _MIN_SCALE)
        P, q = P / steepness, q / steepness
        P.sort_indices()
        A.sort_indices()
        lower = np.concatenate([instance.row_lower, instance.lower]) / length
        upper = np.concatenate([instance.row_upper, instance.upper]) / length
        if (
            self._solver is not None
            and _has_same_pattern(P, self._P)
            and _has_same_pattern(A, self._A)
        ):
            if not (np.array_equal(P.data, self._P.data) and np.array_equal(A.data, self._A.data)):
                self._solver.update(Px=P.data, Ax=A.data)
            self._solver.update(q=q, l=lower, u=upper)
        else:
            self._solver = osqp.OSQP()
            self._solver.setup(P, q, A, lower, upper, **self._options())
        self._P, self._A = P, A
        answer = run_osqp(self._solver, P.nnz + A.nnz)
        status = answer.info.status_val
        x, bound = None, -np.inf
        if status in _SOLVED or status == osqp.SolverStatus.OSQP_MAX_ITER_REACHED:
            x = np.clip(self._width * answer.x, instance.lower, instance.upper)
            multipliers = steepness * np.asarray(answer.y) / length
            bound = compute_dual_bound(instance, x, multipliers[: len(instance.row_lower)])
        return Answer(
            x=x,
            bound=np.inf if status == _INFEASIBLE else bound,
            infeasible=status == _INFEASIBLE,
            nodes=int(answer.info.iter),
            time=time.perf_counter() - begin,
            solver="osqp",
            log=(f"OSQP: {answer.info.status}",),
        )

    def _options(self) -> dict[str, Any]:
        """Return OSQP's options."""
        return {
            "verbose": False,
            "eps_abs": self._tolerance,
            "eps_rel": self._tolerance,
            "max_iter": self._iterations,
            "polishing": True,
            "adaptive_rho_interval": 50,  # by iterations, not by time: the same answer every run
        }


def run_osqp(solver: osqp.OSQP, work: int) -> Any:
    """Run OSQP, in the only place that does; `work` is the number of matrix entries.

    OSQP's own handler of Ctrl-C hides the signal from Python, so it is sent again. Its output is
    dropped, since the handler of the signal reports the interruption.
    """
    with redirect_stdout(io.StringIO()):
        answer = run_uninterruptible(lambda: solver.solve(raise_error=False), work)
    if answer.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
        signal.raise_signal(signal.SIGINT)
    return answer


def _compute_widths(instance: Instance) -> Array:
    """Return widths of the variables' box, 1 where it is open or a point."""
    box = propagate_box(instance)
    width = box.upper - box.lower
    return np.where(np.isfinite(width) & (width > _MIN_WIDTH), width, 1.0)


def _has_same_pattern(first: sparse.csc_matrix, second: sparse.csc_matrix) -> bool:
    """Return whether two matrices have the same sparsity pattern."""
    return (
        first.shape == second.shape
        and np.array_equal(first.indptr, second.indptr)
        and np.array_equal(first.indices, second.indices)
    )
