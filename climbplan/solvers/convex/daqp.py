"""Convex quadratic programs by DAQP, a dual active-set method for small dense problems."""

from __future__ import annotations

import time
from dataclasses import replace

import daqp
import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.convex.clarabel import ClarabelSession
from climbplan.solvers.interruption import run_uninterruptible
from climbplan.solvers.result import Answer
from climbplan.solvers.weak_duality import compute_dual_bound

_UNBOUNDED = 1e30  # no bound, in DAQP's terms
_EQUAL, _INEQUALITY = 5, 0
_OPTIMAL = 1
_PRIMAL_TOLERANCE = 1e-9
# Automatic proximal steps: with a small fixed curvature DAQP fails on many feasible envelope
# programs, whose cost is flat along the products.
_PROXIMAL = -1.0


class DaqpSession:
    """Solves convex quadratic programs in turn with DAQP; fixed variables are eliminated.

    A workspace is reused as long as the same variables are fixed. DAQP gives no certificate, so
    Clarabel solves the programs that DAQP reports as infeasible or fails on.
    """

    def __init__(self) -> None:
        self._model = daqp.Model()
        self._fallback = ClarabelSession()
        self._free: BoolArray | None = None
        self._hessian: Array = np.zeros((0, 0))
        self._matrix: Array = np.zeros((0, 0))

    def solve(self, instance: Instance) -> Answer:
        """Solve an instance without balls.

        Raises:
            UsageError: The instance has balls.
        """
        if "balls" in instance.features:
            raise UsageError("DAQP has no second-order cones: use clarabel")
        begin = time.perf_counter()
        free = instance.lower < instance.upper
        x = np.where(free, 0.0, instance.lower)
        shift = instance.A @ x
        H = instance.P[free][:, free].toarray()
        f = (instance.q + instance.P @ x)[free]
        A = instance.A[:, free].toarray()
        upper = np.concatenate([instance.upper[free], instance.row_upper - shift])
        lower = np.concatenate([instance.lower[free], instance.row_lower - shift])
        # A row without a free variable either holds or proves infeasibility.
        is_empty = np.concatenate([np.zeros(len(f), bool), ~A.any(axis=1)])
        slack = _PRIMAL_TOLERANCE * (1.0 + np.concatenate([np.zeros(len(f)), np.abs(shift)]))
        if ((lower > slack) & is_empty).any() or ((upper < -slack) & is_empty).any():
            return self._build_answer(
                begin, None, np.inf, True, 0, "a row without free variables fails"
            )
        upper = np.where(is_empty, _UNBOUNDED, np.minimum(upper, _UNBOUNDED))
        lower = np.where(is_empty, -_UNBOUNDED, np.maximum(lower, -_UNBOUNDED))
        if not len(f):
            return self._build_answer(begin, x, instance.objective(x), False, 0, "nothing free")
        sense = np.where(lower == upper, _EQUAL, _INEQUALITY).astype(np.int32)
        has_same_structure = (
            self._free is not None
            and np.array_equal(self._free, free)
            and self._matrix.shape == A.shape
        )
        if has_same_structure:
            self._model.update(
                H=None if np.array_equal(H, self._hessian) else H,
                f=f,
                A=None if np.array_equal(A, self._matrix) else A,
                bupper=upper,
                blower=lower,
                sense=sense,
            )
        else:
            self._model = daqp.Model()
            self._model.settings = {"primal_tol": _PRIMAL_TOLERANCE, "eps_prox": _PROXIMAL}
            flag, _ = self._model.setup(H, f, A, upper, lower, sense)
            if flag < 0:
                self._free = None
                return self._solve_by_clarabel(instance, begin, 0, f"DAQP setup returned {flag}")
        self._free, self._hessian, self._matrix = free, H, A
        solution, _, flag, info = run_uninterruptible(self._model.solve, H.size + A.size)
        message, steps = f"DAQP returned {flag}", int(info["iterations"])
        if flag != _OPTIMAL:
            self._free = None  # a workspace that failed is not reused
            return self._solve_by_clarabel(instance, begin, steps, message)
        x[free] = np.clip(solution, instance.lower[free], instance.upper[free])
        multipliers = np.asarray(info["lam"])[len(f) :]
        bound = compute_dual_bound(instance, x, multipliers)
        return self._build_answer(begin, x, bound, False, steps, message)

    def _solve_by_clarabel(self, instance: Instance, begin: float, steps: int, note: str) -> Answer:
        """Solve with Clarabel."""
        answer = self._fallback.solve(instance)
        duration = time.perf_counter() - begin
        return replace(answer, nodes=steps + answer.nodes, time=duration, log=(note, *answer.log))

    @staticmethod
    def _build_answer(
        begin: float, x: Array | None, bound: float, infeasible: bool, steps: int, note: str
    ) -> Answer:
        """Build an answer."""
        duration = time.perf_counter() - begin
        return Answer(x, bound, infeasible, steps, duration, "daqp", (note,))
