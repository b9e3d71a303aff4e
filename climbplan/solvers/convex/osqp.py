"""Convex quadratic programs by OSQP, the operator-splitting method of the published results."""

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
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance
from climbplan.solvers.interruption import run_deaf
from climbplan.solvers.result import Answer
from climbplan.solvers.weak_duality import weak_dual

_ITERATIONS = 10_000
_TOLERANCE = 1e-7  # before polishing
_LEAST = 1e-12
_NARROW = 1e-6
_SOLVED = (osqp.SolverStatus.OSQP_SOLVED, osqp.SolverStatus.OSQP_SOLVED_INACCURATE)
_INFEASIBLE = osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE


class OsqpSession:
    """The factorisation is kept while the matrices are the same, the iterate always.

    Variables are measured in the width of their box and rows have unit length: metres beside
    cosines cost a first-order method four times the iterations.
    """

    def __init__(self, iterations: int = _ITERATIONS, tolerance: float = _TOLERANCE) -> None:
        self._iterations, self._tolerance = iterations, tolerance
        self._width: Array = np.zeros(0)
        self._solver: osqp.OSQP | None = None
        self._P = sparse.csc_matrix((0, 0))
        self._A = sparse.csc_matrix((0, 0))

    def solve(self, instance: Instance) -> Answer:
        """Raises UsageError for balls. Rows come first, then the variables' bounds."""
        if "balls" in instance.features:
            raise UsageError("OSQP has no second-order cones: use clarabel")
        begin = time.perf_counter()
        if len(self._width) != instance.size:
            self._width = _width(instance)
        D = sparse.diags(self._width)
        rows = sparse.vstack([instance.A, sparse.identity(instance.size)]) @ D
        length = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        length[length == 0] = 1.0
        A = (sparse.diags(1.0 / length) @ rows).tocsc()
        P = sparse.triu(D @ instance.P @ D, format="csc")
        q = instance.q * self._width
        steepness = max(np.abs(P.data).max(initial=0.0), np.abs(q).max(initial=0.0), _LEAST)
        P, q = P / steepness, q / steepness
        P.sort_indices()
        A.sort_indices()
        lower = np.concatenate([instance.row_lower, instance.lower]) / length
        upper = np.concatenate([instance.row_upper, instance.upper]) / length
        if self._solver is not None and _alike(P, self._P) and _alike(A, self._A):
            if not (np.array_equal(P.data, self._P.data) and np.array_equal(A.data, self._A.data)):
                self._solver.update(Px=P.data, Ax=A.data)
            self._solver.update(q=q, l=lower, u=upper)
        else:
            self._solver = osqp.OSQP()
            self._solver.setup(
                P,
                q,
                A,
                lower,
                upper,
                verbose=False,
                eps_abs=self._tolerance,
                eps_rel=self._tolerance,
                max_iter=self._iterations,
                polishing=True,
                adaptive_rho_interval=50,  # by iterations, not by time: the same answer every run
            )
        self._P, self._A = P, A
        answer = run_osqp(self._solver, P.nnz + A.nnz)
        status = answer.info.status_val
        x, bound = None, -np.inf
        if status in _SOLVED or status == osqp.SolverStatus.OSQP_MAX_ITER_REACHED:
            x = np.clip(self._width * answer.x, instance.lower, instance.upper)
            multipliers = steepness * np.asarray(answer.y) / length
            bound = weak_dual(instance, x, multipliers[: len(instance.row_lower)])
        return Answer(
            x=x,
            bound=np.inf if status == _INFEASIBLE else bound,
            infeasible=status == _INFEASIBLE,
            nodes=int(answer.info.iter),
            time=time.perf_counter() - begin,
            solver="osqp",
            log=(f"OSQP: {answer.info.status}",),
        )


def run_osqp(solver: osqp.OSQP, work: int) -> Any:
    """OSQP's answer, in the one place that runs it; work: entries of its matrices.

    Its own handler of Ctrl-C, which ends it, hides the signal from Python: it is sent again. What
    it prints of that is said by whoever handles the signal.
    """
    with redirect_stdout(io.StringIO()):
        answer = run_deaf(lambda: solver.solve(raise_error=False), work)
    if answer.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
        signal.raise_signal(signal.SIGINT)
    return answer


def _width(instance: Instance) -> Array:
    """Widths of the variables' box, 1 where it is open or a point."""
    box = propagated_box(instance)
    width = box.upper - box.lower
    return np.where(np.isfinite(width) & (width > _NARROW), width, 1.0)


def _alike(one: sparse.csc_matrix, other: sparse.csc_matrix) -> bool:
    return (
        one.shape == other.shape
        and np.array_equal(one.indptr, other.indptr)
        and np.array_equal(one.indices, other.indices)
    )
