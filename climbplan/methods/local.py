"""Local methods for an instance with fixed integers, by the solver that its form allows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.strategy import Candidate
from climbplan.program.instance import Instance
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.solvers.convex.sessions import ConvexBackend, solve_convex
from climbplan.solvers.ipopt.instances import solve_fixed_integers
from climbplan.solvers.sqp.envelopes import EnvelopeSolver
from climbplan.solvers.sqp.method import SqpOptions, SqpSolver

# form: Clarabel if the rest is convex, local SQP with products, IPOPT with smooth rows
Local = Literal["form", "sqp", "ipopt", "envelopes", "clarabel", "daqp", "osqp"]


@dataclass(frozen=True)
class LocalAnswer:
    """A local method's answer for one candidate, before the exact check."""

    x: Array | None  # (N,) integers included
    word: str  # reason of termination
    programs: int  # convex programs or iterations
    solver: str


class LocalMethod(Protocol):
    """Solves one instance at fixed integers."""

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate locally; may stop if it costs more than the cutoff."""


def create_local_method(
    instance: Instance,
    local: Local = "form",
    sqp: SqpOptions | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
) -> LocalMethod:
    """Create a local method for candidates of an instance.

    Args:
        instance: The instance.
        local: Name of the method.
        sqp: Options of SQP.
        gap: Relative gap of convex programs.
        time_limit: Time limit of all candidates together [s], checked within IPOPT.
        tolerance: Largest violation of rows of a convex rest.

    Raises:
        UsageError: SQP and envelopes do not support smooth rows. A convex solver raises it in
            `solve` where products are left.
    """
    deadline = time.monotonic() + time_limit
    if local == "sqp":
        return _Sqp(SqpSolver(instance, sqp))
    if local == "envelopes":
        return _Envelopes(EnvelopeSolver(instance, (sqp or SqpOptions()).backend))
    if local == "ipopt":
        return _Ipopt(instance, deadline)
    if local == "form":
        convex = _Convex(FixedIntegerForm.of(instance), "clarabel", gap, tolerance)
        return _ByForm(instance, sqp, convex, _Ipopt(instance, deadline))
    return _Convex(FixedIntegerForm.of(instance), local, gap, tolerance)


@dataclass
class _ByForm:
    """Selects the method by the form of the rest; SQP is created when products are left first."""

    instance: Instance
    sqp: SqpOptions | None
    convex: _Convex
    ipopt: _Ipopt
    bilinear: _Sqp | None = None

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate."""
        if self.instance.smooth is not None:
            return self.ipopt.solve(candidate, cutoff)
        fixed_instance = self.convex.fix_integers(candidate)
        if not fixed_instance.products.count:
            return self.convex.solve_fixed(fixed_instance)
        if self.bilinear is None:
            self.bilinear = _Sqp(SqpSolver(self.instance, self.sqp))
        return self.bilinear.solve(candidate, cutoff)


@dataclass(frozen=True)
class _Convex:
    """Solves a convex rest."""

    form: FixedIntegerForm
    backend: ConvexBackend
    gap: float
    tolerance: float

    def fix_integers(self, candidate: Candidate) -> Instance:
        """Return the instance at the candidate's integers."""
        return self.form.at(candidate.values, candidate.alternatives, compact=True)

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate."""
        fixed_instance = self.fix_integers(candidate)
        unsupported = {
            "products": fixed_instance.products.count > 0,
            "smooth rows": fixed_instance.smooth is not None,
        }
        for what, is_left in unsupported.items():
            if is_left:
                raise UsageError(
                    f"{fixed_instance.name}: {self.backend} cannot hold the {what} that are left "
                    "when integers are pinned; use ipopt"
                    + (" or sqp" if what == "products" else "")
                )
        return self.solve_fixed(fixed_instance)

    def solve_fixed(self, fixed_instance: Instance) -> LocalAnswer:
        """Solve an instance with fixed integers."""
        result = solve_convex(fixed_instance, self.backend, self.gap, self.tolerance)
        return LocalAnswer(result.x, result.status, 1, result.solver)


@dataclass(frozen=True)
class _Sqp:
    """Solves a rest with products by local SQP."""

    solver: SqpSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate."""
        result = self.solver.solve(
            candidate.values, candidate.alternatives, candidate.start, cutoff
        )
        x = result.x if result.feasible else None
        return LocalAnswer(x, result.ending, result.programs, "sqp")


@dataclass(frozen=True)
class _Ipopt:
    """Solves a rest with smooth rows by IPOPT."""

    instance: Instance
    deadline: float

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate."""
        integer = self.instance.integer
        start = np.where(integer, np.round(candidate.values), candidate.start)
        point = solve_fixed_integers(self.instance, start, candidate.alternatives, self.deadline)
        x = np.where(integer, start, point.v)
        return LocalAnswer(x, point.word, point.iterations, "ipopt")


@dataclass(frozen=True)
class _Envelopes:
    """Solves a rest with products by envelopes around the start."""

    solver: EnvelopeSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """Solve a candidate."""
        answer = self.solver.solve(candidate.values, candidate.alternatives, candidate.start)
        return LocalAnswer(answer.x, answer.word, 1, "envelopes")
