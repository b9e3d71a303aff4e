"""Mixed-integer convex instances by the compiled tree: presolve, search, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional, conditional_form
from climbplan.solvers.mixed_integer.form import mixed_integer_program
from climbplan.solvers.mixed_integer.memory import Move
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.numbers import Impossible
from climbplan.solvers.mixed_integer.proof import (
    certificate_of,
    certificate_of_nothing,
    proof_deadline,
)
from climbplan.solvers.mixed_integer.recall import Memory, Recall
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


def solve_mixed_integer(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    known: Known | None = None,
    nodes: int = MOST,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Globally optimal x of an instance with binaries, implications and choices.

    gap: relative gap to prove. time_limit: [s]. tolerance: largest violation of any constraint.
    nodes: limit of the tree. proposals: integers to try first. Deterministic unless the time limit
    is hit. Raises UsageError where a direction without cost is not bounded.
    """
    return TreeMemory(gap, tolerance).solve(
        instance, time_limit, known=known, nodes=nodes, proposals=proposals
    )


class TreeMemory(Memory):
    """Solves instances of one statement in turn; each tree begins with the leaves of the last."""

    MOST_LEAVES = 400

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[Conditional], Move] | None = None,
        known: Known | None = None,
        nodes: int = MOST,
        proposals: Sequence[Proposal] = (),
    ) -> SolverResult:
        """As `solve_mixed_integer`. move: where what is remembered stands now.

        proposals: integers to try first. With some, `work` ends a tree only once it has found
        something.
        """
        name = "tree with certificates" if self.proves else "tree"
        warm_up(name, TreeMemory(proves=self.proves).solve)
        begin = time.perf_counter()
        form = conditional_form(instance)
        program = mixed_integer_program(instance, form, begin + time_limit)
        if program is None:
            if self.proves:
                self.certificate = certificate_of_nothing(instance, -np.inf)
            late = _late(begin, known)
            return judged(instance, late, self.gap, self.tolerance)
        if isinstance(program, Impossible):
            if self.proves:
                self.certificate = certificate_of_nothing(instance)
            return judged(instance, _impossible(program.why, begin), self.gap, self.tolerance)
        leaves = self.recall.begun(form, move)
        remembers = leaves is not None and len(leaves.low) > 1
        run = TreeRun.of(program, self.gap, self.tolerance, leaves, self.work)
        if proposals:
            points = np.stack([form.point(p.values, p.alternatives) for p in proposals])
            run.propose(np.round(points[:, program.entities]).astype(np.int64))
        deadline = begin + time_limit
        if leaves is not None and remembers:
            run.go(deadline, min(nodes, Recall.patience(leaves)))
            if not run.finished and not run.worked and time.perf_counter() < deadline:
                run = TreeRun.of(program, self.gap, self.tolerance, leaves.root(), self.work)
                remembers = False
        run.go(deadline, nodes)
        if proposals and run.worked and run.best() is None:
            run.search.whole[place.WORK] = MOST
            run.go(deadline, nodes)
        self.recall.keep(run, form, leaves, remembers, run.best(), self.work)
        if self.proves:
            none = np.zeros(0, np.int64)
            of = Searched(instance, form, run.program, run.search, run.tree, none)
            until = proof_deadline(begin, deadline)
            self.certificate = certificate_of(instance, of, run.bound, until)
        answer = answer_of(instance, form, run, begin, known)
        return judged(instance, answer, self.gap, self.tolerance)


def answer_of(
    instance: Instance, form: Conditional, run: TreeRun, begin: float, known: Known | None = None
) -> Answer:
    """What a search says of an instance."""
    x = run.best()
    whole = run.search.whole
    bound = run.bound
    if known is not None:
        bound = max(bound, known.bound)
    free = int((run.program.numbers.highest > run.program.numbers.lowest).sum())
    steps = run.search.main.iterations[0] + run.search.probe.iterations[0]
    log = [
        f"{len(run.program.entities)} integers, {free} undecided after propagation",
        f"{run.program.size} unknowns, {len(run.program.M)} rows",
        f"{whole[place.NODES]} nodes, {whole[place.PROBES]} probes, {steps} dual steps",
    ]
    if run.full:
        log.append(f"nodes fill {1e-6 * MEMORY:.0f} MB")
    if whole[place.UNPROVED]:
        log.append(f"{whole[place.UNPROVED]} leaves could not be solved to the end")
    return Answer(
        x=None if x is None else x[: instance.size],
        assignment=None if x is None else form.alternatives(x),
        bound=bound,
        infeasible=x is None and run.exhausted,
        nodes=int(whole[place.NODES]),
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(log),
    )


def _late(begin: float, known: Known | None) -> Answer:
    """The limit came before the program was built: nothing is known beyond what was."""
    return Answer(
        x=None,
        bound=-np.inf if known is None else known.bound,
        infeasible=False,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=("the time limit came while the program was built",),
    )


def _impossible(why: str, begin: float) -> Answer:
    return Answer(
        x=None,
        bound=np.inf,
        infeasible=True,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=(f"infeasible: {why}",),
    )
