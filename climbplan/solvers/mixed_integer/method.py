"""Solve mixed-integer convex instances by branch and bound: presolve, search, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.fixed_integers import fix_integers
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.certification import (
    certify_search,
    certify_without_search,
    compute_proof_deadline,
)
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm, build_indicator_form
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift
from climbplan.solvers.mixed_integer.multiplier_map import SearchedTree
from climbplan.solvers.mixed_integer.nodes import UNLIMITED
from climbplan.solvers.mixed_integer.presolve import build_mixed_integer_program
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram, ProvedInfeasible
from climbplan.solvers.mixed_integer.tree_run import MEMORY, TreeRun
from climbplan.solvers.mixed_integer.warm_start import WarmStart, WarmStartedSolver
from climbplan.solvers.mixed_integer.warm_up import warm_up_kernels
from climbplan.solvers.result import (
    FEASIBILITY,
    INFEASIBLE_MESSAGE,
    Answer,
    KnownResult,
    Proposal,
    SolverResult,
    compute_closing_bound,
    judge_answer,
)

_MAX_GIVEN_UP = 20  # leaves after which a search begins again with a larger proximal term
_MAX_RESOLVED = 2000  # leaves that an interior-point method solves again
NAME = "branch-and-bound"


def solve_mixed_integer(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    *,
    known_result: KnownResult | None = None,
    nodes: int = UNLIMITED,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Find the global optimum of an instance with binaries, implications and choices.

    The result is deterministic unless the time limit is hit.

    Args:
        instance: Instance without products and smooth rows.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        known_result: Bound that is known already.
        nodes: Largest number of nodes.
        proposals: Integers to try first.

    Raises:
        UsageError: A direction without cost is not bounded.
    """
    return WarmStartedTree(gap, tolerance).solve(
        instance, time_limit, known_result=known_result, nodes=nodes, proposals=proposals
    )


class WarmStartedTree(WarmStartedSolver):
    """Solves instances of one statement in turn; each tree begins with the leaves of the last."""

    MAX_LEAVES = 400

    by_gradient = False  # whether the linear cost, too, sets the size of the proximal term

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[IndicatorForm], HorizonShift] | None = None,
        known_result: KnownResult | None = None,
        nodes: int = UNLIMITED,
        proposals: Sequence[Proposal] = (),
    ) -> SolverResult:
        """Find the global optimum of an instance, as `solve_mixed_integer` does.

        With proposals the root is always processed, and work ends no tree without an incumbent.

        Args:
            instance: Instance without products and smooth rows.
            time_limit: Time limit [s].
            move: Function that returns the shift of the horizon since the last call.
            known_result: Bound that is known already.
            nodes: Largest number of nodes.
            proposals: Integers to try first.
        """
        name = "tree with certificates" if self.proves else "tree"
        warm_up_kernels(name, WarmStartedTree(proves=self.proves).solve)
        begin = time.perf_counter()
        deadline, nodes = begin + time_limit, max(nodes, 1 if proposals else 0)
        form = build_indicator_form(instance)
        program = build_mixed_integer_program(instance, form, deadline, None, self.by_gradient)
        if program is None:
            if self.proves:
                self.certificate = certify_without_search(instance, -np.inf)
            unsolved = _answer_without_search(begin, known_result)
            return judge_answer(instance, unsolved, self.gap, self.tolerance)
        if isinstance(program, ProvedInfeasible):
            if self.proves:
                self.certificate = certify_without_search(instance)
            infeasible = _answer_infeasible(program.why, begin)
            return judge_answer(instance, infeasible, self.gap, self.tolerance)
        leaves = self.warm_start.select_start(form, move)
        warm_started = leaves is not None and len(leaves.low) > 1
        run = TreeRun.create(program, self.gap, self.tolerance, leaves, self.work)
        if proposals:
            points = np.stack([form.encode_point(p.values, p.alternatives) for p in proposals])
            run.propose(np.round(points[:, program.entities]).astype(np.int64))
        if leaves is not None and warm_started:
            run.run_until(deadline, min(nodes, WarmStart.compute_node_limit(leaves)))
            if not run.is_finished and not run.has_used_budget and time.perf_counter() < deadline:
                run = TreeRun.create(program, self.gap, self.tolerance, leaves.root(), self.work)
                warm_started = False
        run = self._run_accurately(instance, form, run, deadline, nodes)
        if proposals and run.has_used_budget and run.recover_incumbent() is None:
            run.search.counters[slots.MAX_DUAL_STEPS] = UNLIMITED
            run.run_until(deadline, nodes)
        self.warm_start.store(run, form, leaves, warm_started, run.recover_incumbent(), self.work)
        answer = build_answer(instance, form, run, begin, known_result)
        answer = _resolve_given_up_leaves(instance, form, run, answer, deadline)
        if self.proves:
            tree = SearchedTree(instance, form, run.program, run.search, run.tree, np.zeros(0, int))
            cost = np.inf if answer.x is None else instance.objective(answer.x)
            proof_limit = compute_proof_deadline(begin, deadline)
            self.certificate = certify_search(instance, tree, answer.bound, cost, proof_limit)
        return judge_answer(instance, answer, self.gap, self.tolerance)

    def _run_accurately(
        self, instance: Instance, form: IndicatorForm, run: TreeRun, deadline: float, nodes: int
    ) -> TreeRun:
        """Run a search; where it gives up leaves, return another one with a larger proximal term.

        Later instances begin with the larger term. Limits of nodes or dual steps forbid a second
        search.

        Args:
            instance: The instance.
            form: Its indicator form.
            run: The search.
            deadline: Time of `time.perf_counter` [s].
            nodes: Largest number of nodes.
        """
        may_repeat = not self.by_gradient and self.work == UNLIMITED and nodes == UNLIMITED
        run.max_given_up = _MAX_GIVEN_UP if may_repeat else UNLIMITED
        run.run_until(deadline, nodes)
        cost = float(run.search.scalars[slots.INCUMBENT_COST])
        is_proved = run.bound >= compute_closing_bound(cost, self.gap, run.program.zero_cost)
        if not may_repeat or not run.num_given_up or is_proved or time.perf_counter() >= deadline:
            return run
        program = build_mixed_integer_program(instance, form, deadline, None, by_gradient=True)
        if not isinstance(program, MixedIntegerProgram):
            return run
        self.by_gradient = True
        repetition = TreeRun.create(program, self.gap, self.tolerance)
        if np.isfinite(cost):
            repetition.propose(run.search.best_integers[None])
        repetition.run_until(deadline, nodes)
        is_better = repetition.is_finished or repetition.bound >= run.bound
        loses_point = np.isfinite(cost) and repetition.recover_incumbent() is None
        if is_better and not loses_point:
            return repetition
        run.max_given_up = UNLIMITED
        run.run_until(deadline, nodes)
        return run


def _resolve_given_up_leaves(
    instance: Instance, form: IndicatorForm, run: TreeRun, answer: Answer, deadline: float
) -> Answer:
    """Return an answer with the leaves solved on which the active-set method lost accuracy.

    An interior-point method solves those whose integers are all fixed, so that its bound, which
    follows from its multipliers, is that of the leaf. Least bounds come first. A claim that a leaf
    is infeasible is not used.

    Args:
        instance: The instance.
        form: Its indicator form.
        run: The search, which gave up leaves.
        answer: The answer of the search.
        deadline: Time of `time.perf_counter` [s].
    """
    tree, program, gap = run.tree, run.program, float(run.search.scalars[slots.GAP])
    num_nodes = run.search.counters[slots.NUM_NODES]
    state, bounds = tree.state[:num_nodes], tree.bound[:num_nodes].copy()
    is_fixed = (tree.low[:num_nodes] == tree.high[:num_nodes]).all(axis=1)
    given_up = np.flatnonzero((state == slots.GIVEN_UP) & is_fixed)
    if not len(given_up):
        return answer
    x, cost = answer.x, np.inf if answer.x is None else instance.objective(answer.x)
    num_resolved = 0
    for leaf in given_up[np.argsort(bounds[given_up])][:_MAX_RESOLVED]:
        if time.perf_counter() >= deadline:
            break
        if bounds[leaf] >= compute_closing_bound(cost, gap, program.zero_cost):
            break
        point = program.recover_point(np.zeros(program.size), tree.low[leaf])
        chosen = form.decode_alternatives(point)
        solution = solve_convex(fix_integers(instance, point[: instance.size], chosen))
        if solution.x is None or solution.objective is None:
            continue
        num_resolved += 1
        bounds[leaf] = max(bounds[leaf], solution.bound)
        if solution.objective < cost:
            x, cost = solution.x, solution.objective
            answer = replace(answer, x=x, assignment=chosen)
    leaves = (state != slots.BRANCHED) & (state != slots.EMPTY_NODE)
    bound = max(answer.bound, min(float(bounds[leaves].min(initial=np.inf)), cost))
    log = f"{num_resolved} of {len(given_up)} leaves were solved by an interior-point method"
    return replace(answer, bound=bound, log=(*answer.log, log))


def build_answer(
    instance: Instance,
    form: IndicatorForm,
    run: TreeRun,
    begin: float,
    known_result: KnownResult | None = None,
) -> Answer:
    """Build the answer of a search."""
    x = run.recover_incumbent()
    counters = run.search.counters
    bound = run.bound
    if known_result is not None:
        bound = max(bound, known_result.bound)
    num_undecided = int((run.program.data.root_high > run.program.data.root_low).sum())
    steps = run.search.main.iterations[0] + run.search.probe.iterations[0]
    log = [
        f"{len(run.program.entities)} integers, {num_undecided} undecided after propagation",
        f"{run.program.size} unknowns, {len(run.program.M)} rows",
        (
            f"{counters[slots.NUM_PROCESSED]} nodes, {counters[slots.NUM_PROBES]} probes, "
            f"{steps} dual steps"
        ),
    ]
    if run.is_full:
        log.append(f"nodes fill {1e-6 * MEMORY:.0f} MB")
    if counters[slots.NUM_UNPROVED]:
        log.append(
            f"{counters[slots.NUM_UNPROVED]} leaves could not be solved to the end by active sets"
        )
    if x is None and run.proves_infeasible:
        log.append(INFEASIBLE_MESSAGE)
    return Answer(
        x=None if x is None else x[: instance.size],
        assignment=None if x is None else form.decode_alternatives(x),
        bound=bound,
        infeasible=x is None and run.proves_infeasible,
        nodes=int(counters[slots.NUM_PROCESSED]),
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(log),
    )


def _answer_without_search(begin: float, known_result: KnownResult | None) -> Answer:
    """Return the answer where the time limit came before the program was built."""
    return Answer(
        x=None,
        bound=-np.inf if known_result is None else known_result.bound,
        infeasible=False,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=("the time limit came while the program was built",),
    )


def _answer_infeasible(why: str, begin: float) -> Answer:
    """Return the answer of an instance that presolve has proved infeasible."""
    return Answer(
        x=None,
        bound=np.inf,
        infeasible=True,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=(f"infeasible: {why}",),
    )
