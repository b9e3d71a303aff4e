"""`climbplan.Session`: one problem at parameters that change, each answer helped by the last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.solving import Solution
from climbplan.errors import UsageError
from climbplan.program.problem import Problem, Theta
from climbplan.program.statement import Program

if TYPE_CHECKING:
    from climbplan.methods.sequence import ProblemSequence


class Session:
    """Solves the same statement again and again, as a controller does.

        session = climbplan.Session(problem, gap=1e-3)
        first = session.solve({"start": state})
        after = session.solve({"start": next_state}, shift=1)

    The statement's coefficients are taken once; each tree begins with the leaves of the last, and
    its integers are tried first; with products its boxes go on and a local search begins at the
    last answer. With `method="benders"` cuts are remembered in place of leaves. Every answer has
    its own proof of optimality.

    Where a controller cannot wait, a limit of time or work ends the tree early: the answer is then
    the best that was found, `status` "feasible" with the `gap` that is proved, or "limit" where
    nothing was. What is remembered is kept, so that the next tree goes on from there.
    """

    def __init__(self, problem: Problem | Program, **settings: Any) -> None:
        """settings: `gap`, `time_limit` [s] of one solve, `tolerance`, as of `climbplan.solve`.

        `method`: `branch-and-bound` (default) or `benders`.
        `work`: dual steps of one solve, each some microseconds; the same answer whatever the load.
        Raises UsageError for settings that there are not.
        """
        from climbplan.methods.sequence import ProblemSequence
        from climbplan.methods.task import MethodSettings

        method = settings.pop("method", "branch-and-bound")
        strange = sorted(set(settings) - {"gap", "time_limit", "tolerance", "work"})
        if strange:
            raise UsageError(
                f"no setting {', '.join(strange)} of a session: expected method, gap, time_limit, "
                "tolerance, work"
            )
        self.problem = Problem(problem.name, problem) if isinstance(problem, Program) else problem
        self._sequence: ProblemSequence = ProblemSequence(
            self.problem, MethodSettings(**settings), method
        )

    def solve(self, theta: Theta | None = None, *, shift: int = 0) -> Solution:
        """Solve at parameters; shift: steps that a receding horizon has moved since the last call.

        Raises UsageError for parameters that do not fit and for statements that the method does not
        hold, StatementError for what the statement itself does wrong.
        """
        given: Mapping[str, Any] = theta or {}
        with ctrl_c_insists():
            return Solution(self.problem, given, self._sequence.solve(given, shift))

    def forget(self) -> None:
        """Solve the next one without help."""
        self._sequence.forget()

    def __repr__(self) -> str:
        return f"<Session of {self.problem.name!r}>"
