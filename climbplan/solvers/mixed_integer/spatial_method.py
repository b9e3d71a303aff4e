"""Instances with products by the compiled tree: branching on integers and in space.

The tree proves bounds by envelopes that narrow with its nodes. Incumbents come from local searches:
the integers of a relaxation's point are kept, and sequential quadratic programs start from it; the
instance itself judges where they end. The tree's pieces and what is tried between them are counted
in nodes, so that the answer does not depend on the clock.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.certificates.certificate import Certificate
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional, conditional_form
from climbplan.solvers.mixed_integer.form import mixed_integer_program
from climbplan.solvers.mixed_integer.narrowing import NarrowingSearch
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.numbers import Impossible, MixedIntegerProgram
from climbplan.solvers.mixed_integer.proof import (
    certificate_of,
    certificate_of_nothing,
    proof_deadline,
)
from climbplan.solvers.mixed_integer.spatial_rows import Factors, factors_of
from climbplan.solvers.mixed_integer.telling import Searched
from climbplan.solvers.mixed_integer.tree_run import MEMORY, TreeRun
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    Known,
    Proposal,
    SolverResult,
    judged,
)
from climbplan.solvers.sqp.method import SqpSolver

NAME = "branch-and-bound"
_FIRST, _FURTHER, _MOST_PIECE = 1, 1.5, 200  # nodes of the first piece, growth, most of one
_SHARE = 0.25  # of the time, for the compiled tree where a certificate is asked for
_MOST_TOLD = 5_000  # and its nodes: more leaves make certificates that take minutes to check
_STARTS = 3  # local searches that the same integers get once there is an incumbent


@dataclass
class _Incumbent:
    """The best point that was found, and what was tried for it."""

    instance: Instance
    tolerance: float
    x: Array | None = None
    assignment: Index | None = None
    cost: float = np.inf
    tried: Counter[bytes] = field(default_factory=Counter)
    searches: int = 0
    solver: SqpSolver | None = None

    def look(
        self,
        x: Array,
        assignment: Index,
        integers: Array | None = None,
        starts: float = _STARTS,
    ) -> bool:
        """A local search from a point (n,) with its integers kept; True if that found a better.

        integers: (n,) those of another point. starts: that these integers get.
        """
        instance = self.instance
        values = np.where(instance.integer, np.round(x if integers is None else integers), x)
        key = values[instance.integer].tobytes() + assignment.tobytes()
        if self.x is not None and self.tried[key] >= starts:
            return False
        self.tried[key] += 1
        self.searches += 1
        if self.solver is None:
            self.solver = SqpSolver(instance)
        found = self.solver.solve(values, assignment, values, self.cost)
        if found.x is None or not found.feasible:
            return False
        return self.take(found.x, assignment)

    def take(self, x: Array, assignment: Index) -> bool:
        """Whether a point is feasible and better than the best so far, which it then is."""
        instance = self.instance
        if instance.violation(x, assignment) > self.tolerance:
            return False
        cost = instance.objective(x)
        if cost >= self.cost:
            return False
        self.x, self.assignment, self.cost = x, assignment, cost
        return True


def solve_spatial(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    known: Known | None = None,
    nodes: int = MOST,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Globally optimal x of an instance with products, or the best one found in the time or nodes.

    As `method.solve_mixed_integer`. Raises UsageError where nothing bounds a factor of a product.
    """
    return SpatialTree(gap, tolerance).solve(instance, time_limit, known, nodes, proposals)


@dataclass
class SpatialTree:
    """Solves instances with products, with a proof of each bound if that is asked for."""

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    proves: bool = False  # whether each answer comes with its certificate
    certificate: Certificate | None = None  # of the last answer

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        known: Known | None = None,
        nodes: int = MOST,
        proposals: Sequence[Proposal] = (),
    ) -> SolverResult:
        """As `solve_spatial`."""
        begin = time.perf_counter()
        deadline, gap, tolerance = begin + time_limit, self.gap, self.tolerance
        factors = factors_of(instance)
        if factors is None:
            self._proves_nothing(instance)
            return _judged(instance, "bounds cross when they are propagated", begin, gap, tolerance)
        form = conditional_form(factors.instance)
        program = mixed_integer_program(factors.instance, form, deadline, factors)
        if isinstance(program, Impossible):
            self._proves_nothing(instance)
            return _judged(instance, program.why, begin, gap, tolerance)
        if program is None:
            self._proves_nothing(instance, -np.inf)
            late = "the time limit came while the program was built"
            return _judged(instance, late, begin, gap, tolerance, known, infeasible=False)
        run = TreeRun.of(program, gap, tolerance)
        best = _Incumbent(instance, tolerance)
        for proposal in proposals:
            best.look(proposal.start, proposal.alternatives, proposal.values)
        if not self.proves:
            _search(run, form, best, deadline, nodes)
            return judged(instance, _answer(run, best, factors, begin, known), gap, tolerance)
        # A part of the limits: what this tree does not finish another one may
        part = min(deadline, begin + _SHARE * time_limit)
        _search(run, form, best, part, min(nodes, _MOST_TOLD))
        answer = _answer(run, best, factors, begin, known)
        if run.finished or run.search.whole[place.NODES] >= nodes:
            of = Searched(factors.instance, form, run.program, run.search, run.tree, factors.space)
            until = proof_deadline(begin, deadline)
            self.certificate = certificate_of(instance, of, run.bound, until)
        else:
            answer = self._narrowing(instance, best, answer, deadline, nodes)
        return judged(instance, replace(answer, time=time.perf_counter() - begin), gap, tolerance)

    def _narrowing(
        self, instance: Instance, best: _Incumbent, answer: Answer, deadline: float, nodes: int
    ) -> Answer:
        """A search that narrows its nodes, and its certificate."""

        def look(x: Array, assignment: Index) -> float:
            best.look(x, assignment, starts=np.inf)
            return best.cost

        search = NarrowingSearch(instance, self.gap, best.cost, look)
        search.run(deadline, nodes - answer.nodes)
        self.certificate = search.certificate()
        return replace(
            answer,
            x=best.x,
            assignment=best.assignment,
            bound=max(answer.bound, search.bound),
            infeasible=best.x is None and search.finished and search.bound == np.inf,
            nodes=answer.nodes + search.count,
            log=(*answer.log, f"{search.count} nodes narrowed by rows and products"),
        )

    def _proves_nothing(self, instance: Instance, enough: float = np.inf) -> None:
        if self.proves:
            self.certificate = certificate_of_nothing(instance, enough)


def _answer(
    run: TreeRun, best: _Incumbent, factors: Factors, begin: float, known: Known | None
) -> Answer:
    """What a search says."""
    whole, program = run.search.whole, run.program
    integers, space, products = len(program.entities), len(factors.space), factors.products.count
    log = [
        f"{integers} integers, {space} factors of {products} products, {program.size} unknowns",
        f"{whole[place.NODES]} nodes, {whole[place.PROBES]} probes, {best.searches} local searches",
    ]
    if run.full:
        log.append(f"nodes fill {1e-6 * MEMORY:.0f} MB")
    return Answer(
        x=best.x,
        assignment=best.assignment,
        bound=run.bound if known is None else max(run.bound, known.bound),
        infeasible=best.x is None and run.exhausted,
        nodes=int(whole[place.NODES]),
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(log),
    )


def _search(run: TreeRun, form: Conditional, best: _Incumbent, deadline: float, nodes: int) -> None:
    """Pieces of the tree with local searches between them."""
    whole, piece = run.search.whole, float(_FIRST)
    while True:
        run.go(deadline, min(nodes, int(whole[place.NODES] + piece)))
        piece = min(_FURTHER * piece, _MOST_PIECE)
        search, program = run.search, run.program
        whole = search.whole
        if search.real[place.BEST] < best.cost:  # a node whose products are exact
            _look_at(program, form, best, search.best_w, search.best_whole, exact=True)
        if whole[place.SEEDED]:
            whole[place.SEEDED] = 0
            _look_at(program, form, best, search.seed, search.seed_whole)
        search.real[place.BEST] = best.cost
        left = whole[place.HEAP] > 0 or whole[place.NEXT] >= 0
        if not left or run.full or whole[place.NODES] >= nodes or time.perf_counter() >= deadline:
            return


def _look_at(
    program: MixedIntegerProgram,
    form: Conditional,
    best: _Incumbent,
    w: Array,
    integers: Index,
    exact: bool = False,
) -> None:
    """A point of the tree as it is, where its products are exact, and a local search from it."""
    x = program.point(w, integers)
    stated, assignment = x[: best.instance.size], form.alternatives(x)
    if exact and best.take(stated, assignment):
        return
    best.look(stated, assignment)


def _judged(
    instance: Instance,
    why: str,
    begin: float,
    gap: float,
    tolerance: float,
    known: Known | None = None,
    infeasible: bool = True,
) -> SolverResult:
    """The result of a program that was not searched."""
    bound = np.inf if infeasible else -np.inf if known is None else known.bound
    spent, log = time.perf_counter() - begin, (f"infeasible: {why}" if infeasible else why,)
    answer = Answer(None, bound, infeasible, 0, spent, NAME, log)
    return judged(instance, answer, gap, tolerance)
