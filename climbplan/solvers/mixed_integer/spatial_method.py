"""Solve instances with products by branch and bound on integers and in space.

The tree proves bounds by envelopes that tighten with its nodes. Incumbents come from local
searches: the integers of a relaxation's solution are fixed, and sequential quadratic programming
starts from it. Both alternate by numbers of nodes, so the answer does not depend on the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.branch_and_reduce import BranchAndReduce, LocalSearch
from climbplan.solvers.mixed_integer.certification import (
    certify_search,
    certify_without_search,
    compute_proof_deadline,
)
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm, build_indicator_form
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift, LeafCover
from climbplan.solvers.mixed_integer.local_search import Incumbent
from climbplan.solvers.mixed_integer.multiplier_map import SearchedTree
from climbplan.solvers.mixed_integer.nodes import UNLIMITED
from climbplan.solvers.mixed_integer.presolve import build_mixed_integer_program
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram, ProvedInfeasible
from climbplan.solvers.mixed_integer.product_data import ProductFactors, find_factors
from climbplan.solvers.mixed_integer.tree_run import MEMORY, TreeRun
from climbplan.solvers.mixed_integer.warm_start import WarmStart, WarmStartedSolver
from climbplan.solvers.mixed_integer.warm_up import warm_up_kernels
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    KnownResult,
    Proposal,
    SolverResult,
    judge_answer,
    relative_gap,
)

NAME = "branch-and-bound"
_FIRST_PIECE, _PIECE_GROWTH, _MAX_PIECE = (
    1,
    1.5,
    200,
)  # nodes of the first piece, growth, largest piece
_TREE_TIME_FRACTION = (
    0.25  # fraction of the time for the compiled tree where a certificate is required
)
_MAX_CERTIFIED_NODES = (
    5_000  # largest number of its nodes, so that certificates stay quick to check
)

_NODES_BEFORE_REDUCTION = 2_000  # of the compiled tree, before it rests
_REDUCTION_NODES = 2_000  # largest number of nodes of branch and reduce meanwhile
_REDUCTION_TIME_FRACTION = 0.5  # of the time left


def solve_spatial(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    *,
    known_result: KnownResult | None = None,
    nodes: int = UNLIMITED,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Find the global optimum of an instance with products.

    Args:
        instance: Instance without smooth rows.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        known_result: Bound that is known already.
        nodes: Largest number of nodes.
        proposals: Points and integers to try first.

    Raises:
        UsageError: A factor of a product is not bounded.
    """
    return WarmStartedSpatialTree(gap, tolerance).solve(
        instance, time_limit, known_result=known_result, nodes=nodes, proposals=proposals
    )


class WarmStartedSpatialTree(WarmStartedSolver):
    """Solves instances with products in turn; each tree begins with the leaves of the last.

    The first local search starts from the last answer. With certificates each tree begins with its
    root.
    """

    MAX_LEAVES = 40_000  # trees in space have many
    _reduction: BranchAndReduce | None = None  # of the last solve

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[IndicatorForm], HorizonShift] | None = None,
        known_result: KnownResult | None = None,
        nodes: int = UNLIMITED,
        proposals: Sequence[Proposal] = (),
    ) -> SolverResult:
        """Find the global optimum of an instance, as `solve_spatial` does.

        Steps of local searches, of which each tree has few, do not count as `work`.

        Args:
            instance: Instance without smooth rows.
            time_limit: Time limit [s].
            move: Function that returns the shift of the horizon since the last call.
            known_result: Bound that is known already.
            nodes: Largest number of nodes.
            proposals: Points and integers to try first.
        """
        name = "tree with certificates" if self.proves else "tree"
        warm_up_kernels(name, WarmStartedSpatialTree(proves=self.proves).solve, products=True)
        begin = time.perf_counter()
        deadline, gap, tolerance = begin + time_limit, self.gap, self.tolerance
        self._reduction = None
        problem = _build_envelope_program(instance, deadline)
        if isinstance(problem, ProvedInfeasible):
            self._certify_presolve(instance)
            return _judge_unsearched(instance, problem.why, begin, gap, tolerance)
        if problem is None:
            self._certify_presolve(instance, -np.inf)
            reason = "the time limit came while the program was built"
            return _judge_unsearched(
                instance, reason, begin, gap, tolerance, known_result=known_result, infeasible=False
            )
        incumbent = Incumbent(instance, tolerance)
        for proposal in proposals:
            incumbent.search_locally(proposal.start, proposal.alternatives, proposal.values)
        if self.proves:
            answer = self._solve_with_certificate(
                instance, problem, incumbent, begin=begin, deadline=deadline, nodes=nodes
            )
            duration = time.perf_counter() - begin
            bound = answer.bound if known_result is None else max(answer.bound, known_result.bound)
            answer = replace(answer, time=duration, bound=bound)
        else:
            leaves = self.warm_start.select_start(problem.form, move)
            run = self._search_from_leaves(instance, problem, incumbent, leaves, deadline, nodes)
            answer = _build_answer(run, incumbent, problem.factors, begin, known_result)
            if self._reduction is not None:
                answer = _add_reduction(answer, incumbent, self._reduction)
        return judge_answer(instance, answer, gap, tolerance)

    def _search_from_leaves(
        self,
        instance: Instance,
        problem: _EnvelopeProgram,
        incumbent: Incumbent,
        leaves: LeafCover | None,
        deadline: float,
        nodes: int,
    ) -> TreeRun:
        """Search from stored leaves, or from the root where these do not help; store the leaves."""
        program, form = problem.program, problem.form
        if leaves is not None and leaves.best is not None:
            incumbent.search_locally(
                leaves.best[: instance.size], form.decode_alternatives(leaves.best)
            )
        run = TreeRun.create(program, self.gap, self.tolerance, leaves, self.work)
        warm_started = leaves is not None and len(leaves.low) > 1
        if leaves is not None and warm_started:
            _alternate_searches(
                run, form, incumbent, deadline, min(nodes, WarmStart.compute_node_limit(leaves))
            )
            if not run.is_finished and not run.has_used_budget and time.perf_counter() < deadline:
                run = TreeRun.create(program, self.gap, self.tolerance, leaves.root(), self.work)
                warm_started = False
        _alternate_searches(run, form, incumbent, deadline, min(nodes, _NODES_BEFORE_REDUCTION))
        if not run.is_finished and nodes > _NODES_BEFORE_REDUCTION:
            self._reduction = self._reduce_for_a_while(instance, run, incumbent, deadline)
            if self._reduction is None or not _is_decided(self._reduction, incumbent, self.gap):
                _alternate_searches(run, form, incumbent, deadline, nodes)
        point = None
        if incumbent.x is not None and incumbent.assignment is not None:
            lifted = np.concatenate([incumbent.x, instance.products.values(incumbent.x)])
            point = form.encode_point(lifted, incumbent.assignment)
        self.warm_start.store(run, form, leaves, warm_started, point, self.work)
        return run

    def _reduce_for_a_while(
        self, instance: Instance, run: TreeRun, incumbent: Incumbent, deadline: float
    ) -> BranchAndReduce | None:
        """Branch and reduce for some nodes; None where no time is left, or rows do not allow it.

        Where ranges imply each other it ends long before the compiled tree.
        """
        now = time.perf_counter()
        if run.has_used_budget or now >= deadline:
            return None
        search_locally = _create_local_search(incumbent)
        try:
            search = BranchAndReduce(instance, self.gap, incumbent.cost, search_locally)
        except UsageError:  # the checker's rows do not bound a factor
            return None
        search.run(now + _REDUCTION_TIME_FRACTION * (deadline - now), _REDUCTION_NODES)
        return search

    def _solve_with_certificate(
        self,
        instance: Instance,
        problem: _EnvelopeProgram,
        incumbent: Incumbent,
        *,
        begin: float,
        deadline: float,
        nodes: int,
    ) -> Answer:
        """Solve a tree from its root, and certify its bound.

        The compiled tree gets a part of the limits; branch and reduce continues where it does not
        finish.
        """
        factors, form = problem.factors, problem.form
        run = TreeRun.create(problem.program, self.gap, self.tolerance, None, self.work)
        _alternate_searches(
            run,
            form,
            incumbent,
            min(deadline, begin + _TREE_TIME_FRACTION * (deadline - begin)),
            min(nodes, _MAX_CERTIFIED_NODES),
        )
        answer = _build_answer(run, incumbent, factors, begin, None)
        if run.is_finished or run.search.counters[slots.NUM_PROCESSED] >= nodes:
            tree = SearchedTree(
                factors.instance, form, run.program, run.search, run.tree, factors.space
            )
            cost = float(run.search.scalars[slots.INCUMBENT_COST])
            proof_limit = compute_proof_deadline(begin, deadline)
            self.certificate = certify_search(instance, tree, run.bound, cost, proof_limit)
            return answer
        return self._branch_and_reduce(instance, incumbent, answer, deadline, nodes)

    def _branch_and_reduce(
        self, instance: Instance, incumbent: Incumbent, answer: Answer, deadline: float, nodes: int
    ) -> Answer:
        """Continue with branch and reduce, and store its certificate."""
        search_locally = _create_local_search(incumbent)
        search = BranchAndReduce(instance, self.gap, incumbent.cost, search_locally)
        search.run(deadline, nodes - answer.nodes)
        self.certificate = search.build_certificate()
        return _add_reduction(answer, incumbent, search)

    def _certify_presolve(self, instance: Instance, required_bound: float = np.inf) -> None:
        """Store the certificate of an instance that was not searched."""
        if self.proves:
            self.certificate = certify_without_search(instance, required_bound)


@dataclass(frozen=True)
class _EnvelopeProgram:
    """The program over envelopes of products that the tree searches."""

    factors: ProductFactors
    form: IndicatorForm
    program: MixedIntegerProgram


def _build_envelope_program(
    instance: Instance, deadline: float
) -> _EnvelopeProgram | ProvedInfeasible | None:
    """Build the program of an instance with products; None where the deadline comes first.

    Raises:
        UsageError: A factor of a product is not bounded.
    """
    factors = find_factors(instance)
    if factors is None:
        return ProvedInfeasible("bounds cross when they are propagated")
    form = build_indicator_form(factors.instance)
    program = build_mixed_integer_program(factors.instance, form, deadline, factors)
    if program is None or isinstance(program, ProvedInfeasible):
        return program
    return _EnvelopeProgram(factors, form, program)


def _build_answer(
    run: TreeRun,
    incumbent: Incumbent,
    factors: ProductFactors,
    begin: float,
    known_result: KnownResult | None,
) -> Answer:
    """Build the answer of a search."""
    counters, program = run.search.counters, run.program
    num_integers, num_factors, num_products = (
        len(program.entities),
        len(factors.space),
        factors.products.count,
    )
    log = [
        (
            f"{num_integers} integers, {num_factors} factors of {num_products} products, "
            f"{program.size} unknowns"
        ),
        (
            f"{counters[slots.NUM_PROCESSED]} nodes, {counters[slots.NUM_PROBES]} probes, "
            f"{incumbent.num_searches} local searches"
        ),
    ]
    if run.is_full:
        log.append(f"nodes fill {1e-6 * MEMORY:.0f} MB")
    return Answer(
        x=incumbent.x,
        assignment=incumbent.assignment,
        bound=run.bound if known_result is None else max(run.bound, known_result.bound),
        infeasible=incumbent.x is None and run.proves_infeasible,
        nodes=int(counters[slots.NUM_PROCESSED]),
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(log),
    )


def _create_local_search(incumbent: Incumbent) -> LocalSearch:
    """Create the local search that branch and reduce calls."""

    def search_locally(x: Array, assignment: IntArray) -> float:
        incumbent.search_locally(x, assignment, max_starts=np.inf)
        return incumbent.cost

    return search_locally


def _add_reduction(answer: Answer, incumbent: Incumbent, search: BranchAndReduce) -> Answer:
    """Add incumbent and bound of branch and reduce to an answer."""
    is_empty = incumbent.x is None and search.is_finished and search.bound == np.inf
    return replace(
        answer,
        x=incumbent.x,
        assignment=incumbent.assignment,
        bound=max(answer.bound, search.bound),
        infeasible=answer.infeasible or is_empty,
        nodes=answer.nodes + search.num_nodes,
        log=(*answer.log, f"{search.num_nodes} nodes narrowed by rows and products"),
    )


def _is_decided(search: BranchAndReduce, incumbent: Incumbent, gap: float) -> bool:
    """Return whether branch and reduce leaves nothing to the compiled tree.

    Nodes of which no range is left to divide are closed although no point of them may be known.
    """
    if not search.is_finished:
        return False
    if incumbent.x is None:
        return search.bound == np.inf
    return relative_gap(incumbent.cost, search.bound, search.zero_cost) <= gap


def _alternate_searches(
    run: TreeRun, form: IndicatorForm, incumbent: Incumbent, deadline: float, nodes: int
) -> None:
    """Alternate pieces of the tree with local searches."""
    counters, piece = run.search.counters, float(_FIRST_PIECE)
    run.search.scalars[slots.INCUMBENT_COST] = incumbent.cost
    while True:
        run.run_until(deadline, min(nodes, int(counters[slots.NUM_PROCESSED] + piece)))
        piece = min(_PIECE_GROWTH * piece, _MAX_PIECE)
        search, program = run.search, run.program
        counters = search.counters
        if search.scalars[slots.INCUMBENT_COST] < incumbent.cost:  # a node whose products are exact
            _try_tree_point(
                program, form, incumbent, search.best_w, search.best_integers, exact=True
            )
        if counters[slots.HAS_START]:
            counters[slots.HAS_START] = 0
            _try_tree_point(program, form, incumbent, search.start_w, search.start_integers)
        search.scalars[slots.INCUMBENT_COST] = incumbent.cost
        has_open = counters[slots.NUM_OPEN] > 0 or counters[slots.DIVE_NODE] >= 0
        if (
            not has_open
            or run.is_full
            or run.has_used_budget
            or counters[slots.NUM_PROCESSED] >= nodes
        ):
            return
        if time.perf_counter() >= deadline:
            return


def _try_tree_point(
    program: MixedIntegerProgram,
    form: IndicatorForm,
    incumbent: Incumbent,
    w: Array,
    integers: IntArray,
    exact: bool = False,
) -> None:
    """Try a point of the tree as an incumbent if it is exact, and search locally from it."""
    x = program.recover_point(w, integers)
    stated, assignment = x[: incumbent.instance.size], form.decode_alternatives(x)
    if exact and incumbent.update_if_better(stated, assignment):
        return
    incumbent.search_locally(stated, assignment)


def _judge_unsearched(
    instance: Instance,
    why: str,
    begin: float,
    gap: float,
    tolerance: float,
    *,
    known_result: KnownResult | None = None,
    infeasible: bool = True,
) -> SolverResult:
    """Return the result of a program that was not searched."""
    bound = np.inf if infeasible else -np.inf if known_result is None else known_result.bound
    duration, log = time.perf_counter() - begin, (f"infeasible: {why}" if infeasible else why,)
    answer = Answer(None, bound, infeasible, 0, duration, NAME, log)
    return judge_answer(instance, answer, gap, tolerance)
