"""Instances with products by the compiled tree: branching on integers and in space.

The tree proves bounds by envelopes that narrow with its nodes. Incumbents come from local searches:
the integers of a relaxation's point are kept, and sequential quadratic programs start from it; the
instance itself judges where they end. The tree's pieces and what is tried between them are counted
in nodes, so that the answer does not depend on the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional, conditional_form
from climbplan.solvers.mixed_integer.form import mixed_integer_program
from climbplan.solvers.mixed_integer.local_search import Incumbent
from climbplan.solvers.mixed_integer.memory import Move
from climbplan.solvers.mixed_integer.narrowing import NarrowingSearch
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.numbers import Impossible, MixedIntegerProgram
from climbplan.solvers.mixed_integer.proof import (
    certificate_of,
    certificate_of_nothing,
    proof_deadline,
)
from climbplan.solvers.mixed_integer.recall import Memory, Recall
from climbplan.solvers.mixed_integer.spatial_rows import Factors, factors_of
from climbplan.solvers.mixed_integer.telling import Searched
from climbplan.solvers.mixed_integer.tree_run import MEMORY, TreeRun
from climbplan.solvers.mixed_integer.warm_up import warm_up
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    Known,
    Proposal,
    SolverResult,
    judged,
)

NAME = "branch-and-bound"
_FIRST, _FURTHER, _MOST_PIECE = 1, 1.5, 200  # nodes of the first piece, growth, most of one
_SHARE = 0.25  # of the time, for the compiled tree where a certificate is asked for
_MOST_TOLD = 5_000  # and its nodes: more leaves make certificates that take minutes to check


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


class SpatialMemory(Memory):
    """Solves instances of one statement in turn; each tree begins with the leaves of the last.

    Its boxes and integers go on, and the first local search begins where the last answer was. Where
    proofs are asked for each tree begins with its root.
    """

    MOST_LEAVES = 40_000  # trees in space have many

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
        name = "tree with certificates" if self.proves else "tree"
        warm_up(name, SpatialMemory(proves=self.proves).solve, products=True)
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
        best = Incumbent(instance, tolerance)
        for proposal in proposals:
            best.look(proposal.start, proposal.alternatives, proposal.values)
        leaves = None if self.proves else self.recall.begun(form, move)
        remembers = leaves is not None and len(leaves.low) > 1
        if leaves is not None and leaves.best is not None:
            best.look(leaves.best[: instance.size], form.alternatives(leaves.best))
        run = TreeRun.of(program, gap, tolerance, leaves, self.work)
        if self.proves:
            answer = self._proved(instance, run, form, factors, best, (begin, deadline), nodes)
            spent = time.perf_counter() - begin
            bound = answer.bound if known is None else max(answer.bound, known.bound)
            return judged(instance, replace(answer, time=spent, bound=bound), gap, tolerance)
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
        return judged(instance, _answer(run, best, factors, begin, known), gap, tolerance)

    def _proved(
        self,
        instance: Instance,
        run: TreeRun,
        form: Conditional,
        factors: Factors,
        best: Incumbent,
        times: tuple[float, float],
        nodes: int,
    ) -> Answer:
        """The answer of a tree from its root, with a certificate of its bound.

        times: begin and deadline. Within a part of the limits: what this tree does not finish a
        search that narrows its nodes may.
        """
        begin, deadline = times
        _search(
            run,
            form,
            best,
            min(deadline, begin + _SHARE * (deadline - begin)),
            min(nodes, _MOST_TOLD),
        )
        answer = _answer(run, best, factors, begin, None)
        if run.finished or run.search.whole[place.NODES] >= nodes:
            of = Searched(factors.instance, form, run.program, run.search, run.tree, factors.space)
            until = proof_deadline(begin, deadline)
            self.certificate = certificate_of(instance, of, run.bound, until)
            return answer
        return self._narrowing(instance, best, answer, deadline, nodes)

    def _narrowing(
        self, instance: Instance, best: Incumbent, answer: Answer, deadline: float, nodes: int
    ) -> Answer:
        """A search that narrows its nodes, and its certificate."""

        def look(x: Array, assignment: IntArray) -> float:
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
    run: TreeRun, best: Incumbent, factors: Factors, begin: float, known: Known | None
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


def _search(run: TreeRun, form: Conditional, best: Incumbent, deadline: float, nodes: int) -> None:
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
    best: Incumbent,
    w: Array,
    integers: IntArray,
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
