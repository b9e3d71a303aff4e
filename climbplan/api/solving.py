"""`climbplan.solve`: a problem of one's own at some parameters, by any method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.problem import Problem, Theta
from climbplan.program.statement import Program

if TYPE_CHECKING:
    from climbplan.certificates.certificate import Certificate
    from climbplan.methods.table import MethodResult
    from climbplan.program.residuals import CheckReport


@dataclass(frozen=True)
class Solution:
    """An answer to a stated problem, judged by its exact statement."""

    problem: Problem
    theta: Theta
    found: MethodResult

    @property
    def status(self) -> str:
        """ "optimal", "feasible", "infeasible" (proved), or "limit": no answer, `why` says more."""
        return self.found.result.status

    @property
    def why(self) -> str:
        """The method's last words: how its solver ended, or what refused its answer."""
        return self.found.result.log[-1] if self.found.result.log else ""

    @property
    def objective(self) -> float | None:
        """Cost of the exact statement, None without an answer."""
        return self.found.result.objective

    @property
    def bound(self) -> float:
        """Valid for the exact problem; -inf where the method gives none."""
        return self.found.result.bound

    @property
    def gap(self) -> float | None:
        """Relative, between objective and bound."""
        return self.found.result.gap

    @property
    def certificate(self) -> Certificate | None:
        """The proof of `bound`, where the setting `certificate=True` asked for one.

        `climbplan.certificates.checker.check` says what it proves of an instance.
        """
        return self.found.certificate

    @property
    def method(self) -> str:
        """And what of it won: a candidate, a start."""
        winner = self.found.winner
        return f"{self.found.method} ({winner})" if winner else self.found.method

    @property
    def values(self) -> dict[str, Array]:
        """Each variable block in its shape; raises UsageError where there is no answer."""
        return self.problem.values(self._point())

    def __getitem__(self, name: str) -> Array:
        """The values of one variable block."""
        return self.values[name]

    def check(self) -> CheckReport:
        """The residual of every named block of the statement at the answer.

        Behind them what the problem's own checker says, if it has one, as `own.NAME`.
        """
        x = self._point()
        stated = self.problem.program.check(x, self.theta, self.found.result.assignment)
        own = self.problem.own_residuals(self.theta, x)
        return replace(stated, blocks=(*stated.blocks, *own))

    def _point(self) -> Array:
        if self.found.result.x is None:
            raise UsageError(f"no answer to look at: {self._ended()}")
        return self.found.result.x

    def _ended(self) -> str:
        told = f" ({self.why})" if self.why and self.found.result.x is None else ""
        return f"{self.status}{told}"

    def __repr__(self) -> str:
        cost = "" if self.objective is None else f", objective {self.objective:.6g}"
        return f"<Solution of {self.problem.name!r} by {self.method}: {self._ended()}{cost}>"


@ctrl_c_insists()
def solve(
    problem: Problem | Program, theta: Theta | None = None, *, method: str = "auto", **settings: Any
) -> Solution:
    """Solve a problem of your own.

    theta: numbers by parameter block. method: such as "auto" (the own tree where it holds the
    statement, else "micp"), "branch-and-bound", "micp", "mpcc", "minlp-scip", "pinned",
    "knn" (`climbplan.methods.table.METHODS`). settings: fields of
    `climbplan.methods.task.MethodSettings`, such as `gap=1e-3`, `time_limit=10.0` [s],
    `solver="scip"`; `library` and `model` may be files of `climbplan solve`, `gen-data` and
    `climbplan fit-strategy`.

    No answer is returned that violates a row by more than the tolerance. Raises UsageError for
    parameters, methods and settings that do not fit, StatementError for what the statement itself
    does wrong, MissingSolver for a solver that is not installed.
    """
    from climbplan.methods.solved import library_of, model_of
    from climbplan.methods.table import METHODS, solve_instance
    from climbplan.methods.task import MethodSettings

    stated = Problem(problem.name, problem) if isinstance(problem, Program) else problem
    chosen = next((known for known in METHODS if known == method), None)
    if chosen is None:
        raise UsageError(f"unknown method {method!r}: expected one of {', '.join(METHODS)}")
    strange = sorted(set(settings) - set(MethodSettings.__dataclass_fields__))
    if strange:
        known = ", ".join(MethodSettings.__dataclass_fields__)
        raise UsageError(f"no setting {', '.join(strange)}: expected some of {known}")
    if isinstance(settings.get("library"), str | Path):
        settings["library"] = library_of(stated, Path(settings["library"]))
    if isinstance(settings.get("model"), str | Path):
        settings["model"] = model_of(stated, Path(settings["model"]))
    given: Mapping[str, Any] = theta or {}
    return Solution(
        stated, given, solve_instance(stated, given, chosen, replace(MethodSettings(), **settings))
    )
