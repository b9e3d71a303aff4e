"""What is left of an instance when its integers are given, by whichever solver its form allows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.strategy import Candidate
from climbplan.program.instance import Instance
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.convex.sessions import ConvexBackend, solve_convex
from climbplan.solvers.ipopt.instances import solve_pinned
from climbplan.solvers.sqp.envelopes import EnvelopeSolver
from climbplan.solvers.sqp.method import SqpOptions, SqpSolver

# form: Clarabel for a convex rest, local SQP for one with products, IPOPT for one with smooth rows
Local = Literal["form", "sqp", "ipopt", "envelopes", "clarabel", "daqp", "osqp"]


@dataclass(frozen=True)
class LocalAnswer:
    """What a local method made of one candidate, before the exact check."""

    x: Array | None  # (N,) integers included
    word: str  # how it ended
    programs: int  # convex programs or iterations
    solver: str


class LocalMethod(Protocol):
    """Solves what is left of one instance when the integers are given."""

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """A local solution of the candidate; may give up if it costs more than the cutoff."""


def local_method(
    instance: Instance,
    local: Local = "form",
    sqp: SqpOptions | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
) -> LocalMethod:
    """A local method made ready for candidates of an instance.

    time_limit: [s] of all candidates together, looked at within IPOPT. tolerance: of the rows of a
    convex rest. Raises UsageError for SQP and envelopes where rows are smooth; `solve` does for a
    convex solver where products are left.
    """
    deadline = time.monotonic() + time_limit
    if local == "sqp":
        return _Sqp(SqpSolver(instance, sqp))
    if local == "envelopes":
        return _Envelopes(EnvelopeSolver(instance, (sqp or SqpOptions()).backend))
    if local == "ipopt":
        return _Ipopt(instance, deadline)
    if local == "form":
        convex = _Convex(PinnedForm.of(instance), "clarabel", gap, tolerance)
        return _ByForm(instance, sqp, convex, _Ipopt(instance, deadline))
    return _Convex(PinnedForm.of(instance), local, gap, tolerance)


@dataclass
class _ByForm:
    """SQP is made ready when the first candidate leaves products."""

    instance: Instance
    sqp: SqpOptions | None
    convex: _Convex
    ipopt: _Ipopt
    bilinear: _Sqp | None = None

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        if self.instance.smooth is not None:
            return self.ipopt.solve(candidate, cutoff)
        rest = self.convex.rest(candidate)
        if not rest.products.count:
            return self.convex.solved(rest)
        if self.bilinear is None:
            self.bilinear = _Sqp(SqpSolver(self.instance, self.sqp))
        return self.bilinear.solve(candidate, cutoff)


@dataclass(frozen=True)
class _Convex:
    form: PinnedForm
    backend: ConvexBackend
    gap: float
    tolerance: float

    def rest(self, candidate: Candidate) -> Instance:
        return self.form.at(candidate.values, candidate.alternatives, compact=True)

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        rest = self.rest(candidate)
        left = {"products": rest.products.count > 0, "smooth rows": rest.smooth is not None}
        for what, is_left in left.items():
            if is_left:
                raise UsageError(
                    f"{rest.name}: {self.backend} cannot hold the {what} that are left when "
                    "integers are pinned; use ipopt" + (" or sqp" if what == "products" else "")
                )
        return self.solved(rest)

    def solved(self, rest: Instance) -> LocalAnswer:
        found = solve_convex(rest, self.backend, self.gap, self.tolerance)
        return LocalAnswer(found.x, found.status, 1, found.solver)


@dataclass(frozen=True)
class _Sqp:
    solver: SqpSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        found = self.solver.solve(candidate.values, candidate.alternatives, candidate.start, cutoff)
        x = found.x if found.feasible else None
        return LocalAnswer(x, found.ending, found.programs, "sqp")


@dataclass(frozen=True)
class _Ipopt:
    instance: Instance
    deadline: float

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        integer = self.instance.integer
        start = np.where(integer, np.round(candidate.values), candidate.start)
        point = solve_pinned(self.instance, start, candidate.alternatives, self.deadline)
        x = np.where(integer, start, point.v)
        return LocalAnswer(x, point.word, point.iterations, "ipopt")


@dataclass(frozen=True)
class _Envelopes:
    solver: EnvelopeSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        found = self.solver.solve(candidate.values, candidate.alternatives, candidate.start)
        return LocalAnswer(found.x, found.word, 1, "envelopes")
