"""Instances with products by the compiled tree: branching on integers and in space.

The tree proves bounds by envelopes that narrow with its nodes. Incumbents come from local searches:
the integers of a relaxation's point are kept, and sequential quadratic programs start from it; the
instance itself judges where they end. The tree's pieces and what is tried between them are counted
in nodes, so that the answer does not depend on the clock.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional, conditional_form
from climbplan.solvers.mixed_integer.form import mixed_integer_program
from climbplan.solvers.mixed_integer.memory import Leaves, Move
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.numbers import Impossible, MixedIntegerProgram
from climbplan.solvers.mixed_integer.recall import Recall
from climbplan.solvers.mixed_integer.spatial_rows import Factors, factors_of
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
_MOST_LEAVES = 40_000  # that are remembered: trees in space have many
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

    def look(self, x: Array, assignment: Index, integers: Array | None = None) -> bool:
        """A local search from a point (n,) with its integers kept; True if that found a better.

        integers: (n,) those of another point.
        """
        instance = self.instance
        values = np.where(instance.integer, np.round(x if integers is None else integers), x)
        key = values[instance.integer].tobytes() + assignment.tobytes()
        if self.x is not None and self.tried[key] >= _STARTS:
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
    return SpatialMemory(gap, tolerance).solve(
        instance, time_limit, known=known, nodes=nodes, proposals=proposals
    )


@dataclass
class SpatialMemory:
    """Solves instances of one statement in turn; each tree begins with the leaves of the last.

    Its boxes and integers go on, and the first local search begins where the last answer was.
    """

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    work: int = MOST  # dual steps of nodes after which a tree stops with what it has found
    recall: Recall = field(default_factory=lambda: Recall(_MOST_LEAVES))

    @property
    def leaves(self) -> Leaves | None:
        """What the next tree begins with, None for its root."""
        return self.recall.leaves

    @property
    def remembers(self) -> bool:
        """Whether the next tree begins with something."""
        return self.recall.leaves is not None

    def forget(self) -> None:
        """Begin the next tree with its root."""
        self.recall = Recall(_MOST_LEAVES)

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[Conditional], Move] | None = None,
        known: Known | None = None,
        nodes: int = MOST,
        proposals: Sequence[Proposal] = (),
    ) -> SolverResult:
        """As `solve_spatial`. move: where what is remembered stands now.

        Steps of local searches do not count as `work`, of which each tree has few.
        """
        begin = time.perf_counter()
        deadline, gap, tolerance = begin + time_limit, self.gap, self.tolerance
        factors = factors_of(instance)
        if factors is None:
            return _judged(instance, "bounds cross when they are propagated", begin, gap, tolerance)
        form = conditional_form(factors.instance)
        program = mixed_integer_program(factors.instance, form, deadline, factors)
        if isinstance(program, Impossible):
            return _judged(instance, program.why, begin, gap, tolerance)
        if program is None:
            late = "the time limit came while the program was built"
            return _judged(instance, late, begin, gap, tolerance, known, infeasible=False)
        leaves = self.recall.begun(form, move)
        remembers = leaves is not None and len(leaves.low) > 1
        best = _Incumbent(instance, tolerance)
        for proposal in proposals:
            best.look(proposal.start, proposal.alternatives, proposal.values)
        if leaves is not None and leaves.best is not None:
            best.look(leaves.best[: instance.size], form.alternatives(leaves.best))
        run = TreeRun.of(program, gap, tolerance, leaves, self.work)
        if leaves is not None and remembers:
            _search(run, form, best, deadline, min(nodes, Recall.patience(leaves)))
            if not run.finished and not run.worked and time.perf_counter() < deadline:
                run = TreeRun.of(program, gap, tolerance, leaves.root(), self.work)
                remembers = False
        _search(run, form, best, deadline, nodes)
        point = None
        if best.x is not None and best.assignment is not None:
            lifted = np.concatenate([best.x, instance.products.values(best.x)])
            point = form.point(lifted, best.assignment)
        self.recall.keep(run, form, leaves, remembers, point, self.work)
        bound = run.bound if known is None else max(run.bound, known.bound)
        answer = Answer(
            x=best.x,
            assignment=best.assignment,
            bound=bound,
            infeasible=best.x is None and run.exhausted,
            nodes=int(run.search.whole[place.NODES]),
            time=time.perf_counter() - begin,
            solver=NAME,
            log=_told(run, factors, best),
        )
        return judged(instance, answer, gap, tolerance)


def _told(run: TreeRun, factors: Factors, best: _Incumbent) -> tuple[str, ...]:
    """Sizes and counts of a search."""
    program, whole = run.program, run.search.whole
    integers, space, products = len(program.entities), len(factors.space), factors.products.count
    log = [
        f"{integers} integers, {space} factors of {products} products, {program.size} unknowns",
        f"{whole[place.NODES]} nodes, {whole[place.PROBES]} probes, {best.searches} local searches",
    ]
    if run.full:
        log.append(f"nodes fill {1e-6 * MEMORY:.0f} MB")
    return tuple(log)


def _search(run: TreeRun, form: Conditional, best: _Incumbent, deadline: float, nodes: int) -> None:
    """Pieces of the tree with local searches between them."""
    whole, piece = run.search.whole, float(_FIRST)
    run.search.real[place.BEST] = best.cost
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
        if not left or run.full or run.worked or whole[place.NODES] >= nodes:
            return
        if time.perf_counter() >= deadline:
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
