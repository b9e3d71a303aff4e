"""Convex programs with or without second-order cones by Clarabel, an interior-point method."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
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
        program = _build_conic_program(instance)
        self._load(instance, program)
        solution = run_uninterruptible(self._solver.solve, program.P.nnz + program.A.nnz)
        x: Array | None = None
        bound = -np.inf
        if solution.status in _SOLVED:
            x = np.clip(np.array(solution.x), instance.lower, instance.upper)
            if "balls" in instance.features:
                bound = float(solution.obj_val_dual) + instance.constant
            else:
                multipliers = program.read_multipliers(np.array(solution.z))
                bound = compute_dual_bound(instance, x, multipliers[: instance.A.shape[0]])
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

    def _load(self, instance: Instance, program: _QuadraticConicProgram) -> None:
        """Update the numbers of the solver, or rebuild it where the structure differs."""
        P, A, b = program.P, program.A, program.b
        indices = (program.equal, program.above, program.below, P.indptr, P.indices)
        pattern = tuple(
            np.asarray(array, np.int64).tobytes() for array in (*indices, A.indptr, A.indices)
        )
        if self._solver is not None and pattern == self._shape:
            self._solver.update(P=P.data, q=instance.q, A=A.data, b=b)
            return
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False  # presolve does not allow updates
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = _ACCURACY
        self._solver = clarabel.DefaultSolver(P, instance.q, A, b, program.cones, settings)
        self._shape = pattern


@dataclass(frozen=True)
class _QuadraticConicProgram:
    """Minimise 1/2 x'P x + q'x subject to A x + s = b with s in a product of cones.

    Indices are those of the rows of the instance, followed by the bounds of its variables.
    """

    P: sparse.csc_matrix  # (n, n) upper triangle
    A: sparse.csc_matrix  # rows of `equal`, `above`, `below`, then of the balls
    b: Array
    cones: list[Any]
    equal: IntArray  # equations
    above: IntArray  # rows with an upper side
    below: IntArray  # rows with a lower side
    num_rows: int  # rows and bounds of the instance

    def read_multipliers(self, z: Array) -> Array:
        """Return the multipliers of rows and bounds from those of the cones; there are no balls."""
        y = np.zeros(self.num_rows)
        e, a = len(self.equal), len(self.above)
        y[self.equal] = z[:e]
        y[self.above] += z[e : e + a]
        y[self.below] -= z[e + a :]
        return y


def _build_conic_program(instance: Instance) -> _QuadraticConicProgram:
    """Build the conic program of a convex instance."""
    n = instance.size
    rows = sparse.vstack([instance.A, sparse.identity(n, format="csr")]).tocsr()
    lower = np.concatenate([instance.row_lower, instance.lower])
    upper = np.concatenate([instance.row_upper, instance.upper])
    equal = np.flatnonzero(np.isfinite(lower) & (lower == upper))
    above = np.flatnonzero(np.isfinite(upper) & (lower < upper))
    below = np.flatnonzero(np.isfinite(lower) & (lower < upper))
    blocks = [rows[equal], rows[above], -rows[below]]
    right_sides = [lower[equal], upper[above], -lower[below]]
    cones = [
        clarabel.ZeroConeT(len(equal)),
        clarabel.NonnegativeConeT(len(above) + len(below)),
    ]
    for balls in instance.balls:
        K, d = balls.f.shape
        # The d rows of every ball follow the one of its radius
        entry = sparse.coo_matrix(balls.F)
        row = entry.row + entry.row // d + 1
        shape = (K * (d + 1), n)
        block = sparse.csr_matrix((-entry.data, (row, entry.col)), shape=shape)
        if balls.slope is not None:
            limit = sparse.coo_matrix(balls.slope)
            block += sparse.csr_matrix((-limit.data, (limit.row * (d + 1), limit.col)), shape=shape)
        blocks.append(block)
        right_sides.append(np.column_stack([balls.radius, balls.f]).ravel())
        cones += [clarabel.SecondOrderConeT(d + 1)] * K
    P = sparse.triu(instance.P, format="csc")
    A = sparse.vstack(blocks).tocsc()
    P.sort_indices()
    A.sort_indices()
    b = np.concatenate(right_sides)
    return _QuadraticConicProgram(P, A, b, cones, equal, above, below, len(lower))
