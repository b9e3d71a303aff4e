"""Run IPOPT on a program that is compiled once: parameters change, and it can be stopped.

This is the only place that calls IPOPT. Each call has a deadline, and Ctrl-C and SIGTERM end it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.stage_derivatives import ProgramDerivatives
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.interruption import Deadline, interruptible


@dataclass(frozen=True)
class NlpPoint:
    """The point at which IPOPT stopped, converged or not."""

    v: Array  # (N,)
    objective: float
    rows: Array  # (M,)
    iterations: int
    word: str  # IPOPT's return status
    success: bool  # whether IPOPT reports success


class IpoptProgram:
    """A program in CasADi's form: variables `x`, parameters `p`, cost `f` and rows `g`."""

    def __init__(
        self,
        name: str,
        problem: Mapping[str, Any],
        settings: Mapping[str, Any],
        expand: bool = False,
        hessian: ca.Function | None = None,
        derivatives: ProgramDerivatives | None = None,
    ) -> None:
        """Compile a program.

        Args:
            name: Name for CasADi.
            problem: Expressions x, p, f and g.
            settings: Options of IPOPT.
            expand: Whether to use one expression graph instead of function calls.
            hessian: Upper triangle of the Lagrangian's Hessian, of (x, p, weight of the cost,
                multipliers); CasADi's own if missing.
            derivatives: All derivatives, in place of CasADi's own.
        """
        # Rows that are identically zero have no entry, which CasADi's solvers do not accept
        problem = {k: ca.densify(v) if k == "g" else v for k, v in problem.items()}
        self.size = int(problem["x"].numel())
        sizes = (problem[key].numel() if key in problem else 0 for key in ("x", "g", "p"))
        self._deadline = Deadline(*sizes)
        options: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": False,  # the status says so
            "iteration_callback": self._deadline,
            "ipopt": {"print_level": 0, "sb": "yes", "linear_solver": "mumps", **settings},
        }
        if expand:
            options["expand"] = True
        if hessian is not None:
            options["hess_lag"] = hessian
        if derivatives is not None:
            options |= {
                "grad_f": derivatives.gradient,
                "jac_g": derivatives.jacobian,
                "hess_lag": derivatives.hessian,
            }
        self._solver = ca.nlpsol(name, "ipopt", dict(problem), options)

    def solve(self, start: Array, numbers: Any, bounds: Bounds, deadline: float) -> NlpPoint:
        """Run from a start (N,), until `deadline` in `time.monotonic` seconds.

        The point may violate bounds by the 1e-8 by which IPOPT widens them. Ctrl-C and SIGTERM stop
        IPOPT and are passed on.
        """
        self._deadline.time_limit = deadline
        with interruptible(self._deadline.stop):
            answer = self._solver(
                x0=start,
                p=numbers,
                lbx=bounds.lower,
                ubx=bounds.upper,
                lbg=bounds.row_lower,
                ubg=bounds.row_upper,
            )
        stats = self._solver.stats()
        return NlpPoint(
            v=np.array(answer["x"]).ravel(),
            objective=float(answer["f"]),
            rows=np.array(answer["g"]).ravel(),
            iterations=int(stats.get("iter_count", 0)),
            word=str(stats["return_status"]),
            success=bool(stats["success"]),
        )

    def rows(self, x: Array, numbers: Any) -> Array:
        """Return the values (M,) of the rows at a point (N,), as in IPOPT."""
        return np.array(self._solver.get_function("nlp_g")(x, numbers)).ravel()
