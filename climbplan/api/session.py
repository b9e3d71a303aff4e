"""`climbplan.Session`: solve one problem at changing parameters, each solve warm-started."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.solving import Solution
from climbplan.deprecation import RenamedAttribute, renamed_parameters
from climbplan.errors import UsageError
from climbplan.program.problem import Problem, Theta
from climbplan.program.statement import Program

if TYPE_CHECKING:
    from climbplan.methods.sequence import ProblemSequence


class Session:
    """Solves one parametric problem repeatedly, as a model-predictive controller does.

        session = climbplan.Session(problem, gap=1e-3)
        first = session.solve({"start": state})
        after = session.solve({"start": next_state}, horizon_shift=1)

    The coefficients of the formulation are built once. Each branch and bound starts from the leaves
    of the previous tree and tries its integers first; with bilinear terms it keeps the bisected
    domains, and a local search starts at the previous solution. With `method="benders"` cuts are
    reused in place of leaves. Every solution has its own proof of optimality.

    A limit of time or work ends the tree early where a controller cannot wait. The solution is then
    the best incumbent: `status` is "feasible" with the proved `gap`, or "limit" without an
    incumbent. The next solve continues from the open leaves.
    """

    def __init__(self, problem: Problem | Program, **settings: Any) -> None:
        """Build the coefficients of a problem.

        Args:
            problem: the problem, or its program alone.
            settings: `gap` (relative), `time_limit` [s] of one solve and `tolerance` of rows, with
                the meaning they have in `climbplan.solve`; `method`, "branch-and-bound" (default)
                or "benders"; `work`, a limit on the dual simplex steps of one solve, which gives
                the same result whatever the load of the machine.

        Raises:
            UsageError: a setting is not known.
        """
        from climbplan.methods.sequence import ProblemSequence
        from climbplan.methods.task import MethodSettings

        method = settings.pop("method", "branch-and-bound")
        unknown = sorted(set(settings) - {"gap", "time_limit", "tolerance", "work"})
        if unknown:
            raise UsageError(
                f"no setting {', '.join(unknown)} of a session: expected method, gap, time_limit, "
                "tolerance, work"
            )
        self.problem = Problem(problem.name, problem) if isinstance(problem, Program) else problem
        self._sequence: ProblemSequence = ProblemSequence(
            self.problem, MethodSettings(**settings), method
        )

    @renamed_parameters(shift="horizon_shift")
    def solve(self, theta: Theta | None = None, *, horizon_shift: int = 0) -> Solution:
        """Solve the problem at given parameters.

        Args:
            theta: numbers by parameter block; None for a problem without parameters.
            horizon_shift: steps by which a receding horizon has moved since the last call.

        Raises:
            UsageError: the parameters do not fit, or the method does not support the formulation.
            StatementError: the formulation itself has a mistake.
        """
        parameters: Mapping[str, Any] = theta or {}
        with ctrl_c_insists():
            result = self._sequence.solve(parameters, horizon_shift)
        return Solution(self.problem, parameters, result)

    def reset(self) -> None:
        """Forget the previous solves, so that the next one is a cold start."""
        self._sequence.reset()

    forget = RenamedAttribute("reset")

    def __repr__(self) -> str:
        return f"<Session of {self.problem.name!r}>"
