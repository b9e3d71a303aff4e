"""Convex programs with or without second-order cones by Clarabel, an interior-point method."""

from __future__ import annotations

import time
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.solvers.interruption import run_uninterruptible
from climbplan.solvers.result import Answer
from climbplan.solvers.weak_duality import compute_dual_bound

_ACCURACY = 1e-10
_SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
_INFEASIBLE = clarabel.SolverStatus.PrimalInfeasible


class ClarabelSession:
    """Solves convex instances in turn with Clarabel; the solver is reused while its structure is.

    It is rebuilt when other bounds become finite or equal; else only coefficients are updated.
    """

    def __init__(self) -> None:
        self._solver: Any = None
        self._shape: tuple[bytes, ...] = ()

    def solve(self, instance: Instance) -> Answer:
        """Solve A x + s = b with s in a zero cone, an orthant and second-order cones."""
        begin = time.perf_counter()
        n, m = instance.size, instance.A.shape[0]
        rows = sparse.vstack([instance.A, sparse.identity(n, format="csr")]).tocsr()
        lower = np.concatenate([instance.row_lower, instance.lower])
        upper = np.concatenate([instance.row_upper, instance.upper])
        equal = np.flatnonzero(np.isfinite(lower) & (lower == upper))
        above = np.flatnonzero(np.isfinite(upper) & (lower < upper))
        below = np.flatnonzero(np.isfinite(lower) & (lower < upper))
        blocks, right_sides = [rows[equal], rows[above], -rows[below]], []
        right_sides += [lower[equal], upper[above], -lower[below]]
        cones = [
            clarabel.ZeroConeT(len(equal)),
            clarabel.NonnegativeConeT(len(above) + len(below)),
        ]
        for balls in instance.balls:
            K, d = balls.f.shape
            # The d rows of every ball follow one without entries, for its radius
            entry = sparse.coo_matrix(balls.F)
            row = entry.row + entry.row // d + 1
            shape = (K * (d + 1), n)
            blocks.append(sparse.csr_matrix((-entry.data, (row, entry.col)), shape=shape))
            right_sides.append(np.column_stack([balls.radius, balls.f]).ravel())
            cones += [clarabel.SecondOrderConeT(d + 1)] * K
        P = sparse.triu(instance.P, format="csc")
        A = sparse.vstack(blocks).tocsc()
        P.sort_indices()
        A.sort_indices()
        b = np.concatenate(right_sides)
        pattern = tuple(
            np.asarray(array, np.int64).tobytes()
            for array in (equal, above, below, P.indptr, P.indices, A.indptr, A.indices)
        )
        if self._solver is not None and pattern == self._shape:
            self._solver.update(P=P.data, q=instance.q, A=A.data, b=b)
        else:
            settings = clarabel.DefaultSettings()
            settings.verbose = False
            settings.presolve_enable = False  # presolve does not allow updates
            settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = _ACCURACY
            self._solver = clarabel.DefaultSolver(P, instance.q, A, b, cones, settings)
            self._shape = pattern
        solution = run_uninterruptible(self._solver.solve, P.nnz + A.nnz)
        x: Array | None = None
        bound = -np.inf
        if solution.status in _SOLVED:
            x = np.clip(np.array(solution.x), instance.lower, instance.upper)
            if "balls" in instance.features:
                bound = float(solution.obj_val_dual) + instance.constant
            else:
                z = np.array(solution.z)
                y = np.zeros(m + n)
                y[equal] = z[: len(equal)]
                y[above] += z[len(equal) : len(equal) + len(above)]
                y[below] -= z[len(equal) + len(above) :]
                bound = compute_dual_bound(instance, x, y[:m])
        infeasible = solution.status == _INFEASIBLE
        return Answer(
            x=x,
            bound=np.inf if infeasible else bound,
            infeasible=infeasible,
            nodes=int(solution.iterations),
            time=time.perf_counter() - begin,
            solver="clarabel",
            log=(f"Clarabel: {solution.status}",),
        )
