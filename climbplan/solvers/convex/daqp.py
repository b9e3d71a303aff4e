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
from climbplan.solvers.interruption import run_deaf
from climbplan.solvers.result import Answer
from climbplan.solvers.weak_duality import weak_dual

_UNBOUNDED = 1e30  # no bound, in DAQP's terms
_EQUAL, _INEQUALITY = 5, 0
_OPTIMAL = 1
_PRIMAL_TOLERANCE = 1e-9
# Automatic proximal steps. The default curvature, or any small fixed one, made DAQP call 11 of 20
# feasible envelope programs (cost flat along the products) infeasible and give up on 6.
_PROXIMAL = -1.0


class DaqpSession:
    """Fixed variables are eliminated; a workspace serves as long as the same ones are fixed.

    DAQP gives no certificate, so that what it calls infeasible, or gives up, Clarabel is asked.
    """

    def __init__(self) -> None:
        self._model = daqp.Model()
        self._judge = ClarabelSession()
        self._free: BoolArray | None = None
        self._hessian: Array = np.zeros((0, 0))
        self._matrix: Array = np.zeros((0, 0))

    def solve(self, instance: Instance) -> Answer:
        """Raises UsageError for balls."""
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
        # A row without a free variable left is a number: true, or a proof.
        empty = np.concatenate([np.zeros(len(f), bool), ~A.any(axis=1)])
        slack = _PRIMAL_TOLERANCE * (1.0 + np.concatenate([np.zeros(len(f)), np.abs(shift)]))
        if ((lower > slack) & empty).any() or ((upper < -slack) & empty).any():
            return self._answer(begin, None, np.inf, True, 0, "a row without free variables fails")
        upper = np.where(empty, _UNBOUNDED, np.minimum(upper, _UNBOUNDED))
        lower = np.where(empty, -_UNBOUNDED, np.maximum(lower, -_UNBOUNDED))
        if not len(f):
            return self._answer(begin, x, instance.objective(x), False, 0, "nothing free")
        sense = np.where(lower == upper, _EQUAL, _INEQUALITY).astype(np.int32)
        same = (
            self._free is not None
            and np.array_equal(self._free, free)
            and self._matrix.shape == A.shape
        )
        if same:
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
                return self._second(instance, begin, 0, f"DAQP setup returned {flag}")
        self._free, self._hessian, self._matrix = free, H, A
        found, _, flag, info = run_deaf(self._model.solve, H.size + A.size)
        note, steps = f"DAQP returned {flag}", int(info["iterations"])
        if flag != _OPTIMAL:
            self._free = None  # a workspace that failed is not a start
            return self._second(instance, begin, steps, note)
        x[free] = np.clip(found, instance.lower[free], instance.upper[free])
        multipliers = np.asarray(info["lam"])[len(f) :]
        bound = weak_dual(instance, x, multipliers)
        return self._answer(begin, x, bound, False, steps, note)

    def _second(self, instance: Instance, begin: float, steps: int, note: str) -> Answer:
        found = self._judge.solve(instance)
        spent = time.perf_counter() - begin
        return replace(found, nodes=steps + found.nodes, time=spent, log=(note, *found.log))

    @staticmethod
    def _answer(
        begin: float, x: Array | None, bound: float, infeasible: bool, steps: int, note: str
    ) -> Answer:
        spent = time.perf_counter() - begin
        return Answer(x, bound, infeasible, steps, spent, "daqp", (note,))
