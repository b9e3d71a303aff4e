"""`climbplan.solve`: solve a problem of your own at given parameters, by any method."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.arrays import Array
from climbplan.deprecation import RenamedAttribute, current_method_name, warn_renamed
from climbplan.errors import UsageError
from climbplan.program.problem import Problem, Theta
from climbplan.program.statement import Program
from climbplan.schema.fields import find_closest_name

if TYPE_CHECKING:
    from climbplan.certificates.certificate import Certificate
    from climbplan.methods.table import MethodResult
    from climbplan.program.residuals import CheckReport


@dataclass(frozen=True)
class Solution:
    """The outcome of one solve, evaluated by the exact formulation of the problem."""

    problem: Problem
    theta: Theta
    method_result: MethodResult

    @property
    def status(self) -> str:
        """One of "optimal", "feasible", "infeasible" (proved) and "limit" (see `message`)."""
        return self.method_result.result.status

    @property
    def message(self) -> str:
        """Last line of the method's log: how its solver ended, or what the solution violates."""
        return self.method_result.result.log[-1] if self.method_result.result.log else ""

    @property
    def objective(self) -> float | None:
        """Cost in the exact formulation; None without a solution."""
        return self.method_result.result.objective

    @property
    def bound(self) -> float:
        """Lower bound that is valid for the exact problem; -inf where the method gives none."""
        return self.method_result.result.bound

    @property
    def gap(self) -> float | None:
        """Relative gap between objective and bound."""
        return self.method_result.result.gap

    @property
    def certificate(self) -> Certificate | None:
        """The proof of `bound`, where the setting `certificate=True` asked for one.

        `climbplan.certificates.checker.check` says what it proves of an instance.
        """
        return self.method_result.certificate

    @property
    def method_name(self) -> str:
        """Name of the method that was run, as in the table of methods."""
        return self.method_result.method

    @property
    def candidate(self) -> str:
        """The candidate or starting point whose solution was selected; "" for other methods."""
        return self.method_result.winner

    @property
    def _method_shown(self) -> str:
        return f"{self.method_name} ({self.candidate})" if self.candidate else self.method_name

    @property
    def method(self) -> str:
        """The old name of `method_name` and `candidate`, in one text."""
        warn_renamed("`Solution.method`", "`Solution.method_name` and `Solution.candidate`")
        return self._method_shown

    why = RenamedAttribute("message")

    @property
    def values(self) -> dict[str, Array]:
        """Values of each variable block in its shape; raises UsageError without a solution."""
        return self.problem.values(self._point())

    def __getitem__(self, name: str) -> Array:
        """Return the values of one variable block; KeyError for others names the nearest."""
        values = self.values
        if name not in values:
            nearest = find_closest_name(name, list(values))
            hint = f" (did you mean {nearest!r}?)" if nearest else ""
            raise KeyError(f"no variable {name!r}{hint}: expected one of {', '.join(values)}")
        return values[name]

    def check(self) -> CheckReport:
        """Compute the residual of every named block of the formulation at the solution.

        The residuals of the problem's own exact checker, if it has one, follow as `own.NAME`.
        """
        x = self._point()
        residuals = self.problem.program.check(x, self.theta, self.method_result.result.assignment)
        exact = self.problem.own_residuals(self.theta, x)
        return replace(residuals, blocks=(*residuals.blocks, *exact))

    def _point(self) -> Array:
        if self.method_result.result.x is None:
            raise UsageError(f"there is no solution: {self._outcome()}")
        return self.method_result.result.x

    def _outcome(self) -> str:
        reason = (
            f" ({self.message})" if self.message and self.method_result.result.x is None else ""
        )
        return f"{self.status}{reason}"

    def _repr_html_(self) -> str:
        """Return status, cost and bound, and the values of each block, as HTML."""
        text = html.escape(repr(self)[1:-1])
        if self.method_result.result.x is None:
            return f"<p><b>{text}</b></p>"
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{values.shape}</td>"
            f"<td>{html.escape(np.array2string(values, precision=4, threshold=12))}</td></tr>"
            for name, values in self.values.items()
        )
        head = "<tr><th>variable</th><th>shape</th><th>values</th></tr>"
        table = f'<div style="overflow-x:auto"><table>{head}{rows}</table></div>'
        return f"<p><b>{text}</b>, bound {self.bound:.6g}</p>{table}"

    def __repr__(self) -> str:
        cost = "" if self.objective is None else f", objective {self.objective:.6g}"
        return (
            f"<Solution of {self.problem.name!r} by {self._method_shown}: {self._outcome()}{cost}>"
        )


@ctrl_c_insists()
def solve(
    problem: Problem | Program, theta: Theta | None = None, *, method: str = "auto", **settings: Any
) -> Solution:
    """Solve a problem of your own.

    No solution is returned that violates a row by more than the tolerance.

    Args:
        problem: the problem, or its program alone.
        theta: numbers by parameter block; None for a problem without parameters.
        method: a name from `climbplan.methods.table.METHODS`, such as "branch-and-bound",
            "mccormick", "mpcc", "minlp-scip", "pinned" or "knn". "auto" takes the built-in branch
            and bound where it supports the formulation, "mccormick" otherwise.
        settings: fields of `climbplan.methods.task.MethodSettings`, such as `gap=1e-3`,
            `time_limit=10.0` [s] or `solver="scip"`. `library` and `model` may be files of
            `climbplan solve`, `climbplan gen-data` and `climbplan fit-strategy`.

    Raises:
        UsageError: parameters, method or settings do not fit.
        StatementError: the formulation itself has a mistake.
        MissingSolver: the solver is not installed.
    """
    from climbplan.methods.solved import read_library, read_strategy_model
    from climbplan.methods.table import METHODS, solve_instance
    from climbplan.methods.task import MethodSettings

    exact_problem = Problem(problem.name, problem) if isinstance(problem, Program) else problem
    method = current_method_name("program", method, stacklevel=5)
    if isinstance(settings.get("fallback"), str):
        settings["fallback"] = current_method_name("program", settings["fallback"], stacklevel=5)
    selected = next((name for name in METHODS if name == method), None)
    if selected is None:
        raise UsageError(f"unknown method {method!r}: expected one of {', '.join(METHODS)}")
    unknown = sorted(set(settings) - set(MethodSettings.__dataclass_fields__))
    if unknown:
        setting_names = [*MethodSettings.__dataclass_fields__, "method"]
        closest = find_closest_name(unknown[0], setting_names)
        hint = f" (did you mean {closest!r}?)" if closest else ""
        raise UsageError(
            f"no setting {', '.join(unknown)}{hint}: expected some of {', '.join(setting_names)}"
        )
    if isinstance(settings.get("library"), str | Path):
        settings["library"] = read_library(exact_problem, Path(settings["library"]))
    if isinstance(settings.get("model"), str | Path):
        settings["model"] = read_strategy_model(exact_problem, Path(settings["model"]))
    parameters: Mapping[str, Any] = theta or {}
    method_settings = replace(MethodSettings(), **settings)
    return Solution(
        exact_problem,
        parameters,
        solve_instance(exact_problem, parameters, selected, method_settings),
    )
