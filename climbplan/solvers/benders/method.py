"""Mixed-integer convex programs by generalised Benders decomposition, with memory.

HiGHS proposes integers that satisfy all cuts (`master`), the compiled solver of the tree solves the
convex program that is left, whose multipliers are a further cut (`cuts`), until the cheapest answer
and the least that the cuts allow meet. Cuts are kept for the next problem of the same statement,
where they are read at its numbers: X. Lin, arXiv 2406.00780; Geoffrion 1972.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.benders.cuts import Cut, CutForm, Planes
from climbplan.solvers.benders.master import Master
from climbplan.solvers.benders.subproblem import Subproblem
from climbplan.solvers.highs.model import highs, linear_model, run_highs
from climbplan.solvers.mixed_integer.conditional import Conditional, conditional_form
from climbplan.solvers.mixed_integer.form import mixed_integer_program
from climbplan.solvers.mixed_integer.memory import Move
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.numbers import Impossible
from climbplan.solvers.mixed_integer.warm_up import warm_up
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    SolverResult,
    judged,
    relative_gap,
)

_LEAST = 1e-12  # entries of a ray below this share of the largest are rounding


def farkas_ray(form: Conditional, read: CutForm, integers: IntArray, x: Array) -> Cut | None:
    """A cut that excludes integers (E,), None where none is found. x: (size,) a point near them.

    HiGHS gives the ray for programs that the tree's solver gives up. What it proves is computed
    from the ray like that of any other cut, so that HiGHS is not believed.
    """
    program = read.program
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[program.entities] = upper[program.entities] = integers
    on = np.flatnonzero(form.value == lower[form.when])
    A = sparse.vstack([form.A, form.C[on]]).tocsr()
    solver = highs()
    solver.setOptionValue("presolve", "off")  # which keeps no rays
    solver.passModel(
        linear_model(
            np.zeros(form.size),
            0.0,
            lower,
            upper,
            np.zeros(form.size, bool),
            A,
            np.concatenate([form.row_lower, form.when_lower[on]]),
            np.concatenate([form.row_upper, form.when_upper[on]]),
        )
    )
    run_highs(solver)
    if solver.getModelStatus() != highspy.HighsModelStatus.kInfeasible:
        return None
    _, there, ray = solver.getDualRay()
    if not there:
        return None
    rows = np.concatenate([np.arange(A.shape[0] - len(on)), A.shape[0] - len(on) + on])
    for y in (np.asarray(ray), -np.asarray(ray)):
        both = np.concatenate([-(A.T @ y), y])  # bounds take what rows pull at each variable
        key = np.concatenate([np.arange(form.size), form.size + rows])
        keep = np.abs(both) > _LEAST * np.abs(both).max(initial=0.0)
        cut = Cut(key[keep], both[keep] / np.abs(both).max(initial=1e-300), x, False)
        plane = read.planes([cut])
        off = np.where((integers > 0) == plane.star[0], 0.0, plane.slope[0]).sum()
        if plane.bound[0] - off > 0.0:
            return cut
    return None


NAME = "benders"
HOLDS = frozenset({"choices", "integers", "implications"})
_MOST_CUTS = 300  # that are kept, the latest ones
_SHARE = 0.5  # of the gap that the master may leave


def solve_benders(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
) -> SolverResult:
    """Globally optimal x of an instance with binaries, implications and choices.

    gap: relative gap to prove. time_limit: [s]. tolerance: largest violation of any constraint.
    Deterministic unless the time limit is hit. Raises UsageError for balls, products and smooth
    rows, and where a direction without cost is not bounded.
    """
    return BendersMemory(gap, tolerance).solve(instance, time_limit)


@dataclass
class _State:
    """What is known of one problem."""

    best: Array | None = None  # (size,) in the variables of the conditional form
    cost: float = np.inf
    bound: float = -np.inf
    infeasible: bool = False
    tried: set[bytes] = field(default_factory=set)
    nodes: int = 0  # of the masters
    unsolved: int = 0  # sets of integers that no cut, or no good one, was found for
    left: float = np.inf  # and what they cost at least
    word: str = ""  # why it ended without a proof

    def leave(self, bound: float) -> None:
        """One set of integers is given up, which costs no less than a bound."""
        self.unsolved += 1
        self.left = min(self.left, bound)


@dataclass
class BendersMemory:
    """Solves instances of one statement in turn; each begins with the cuts of those before."""

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    work: int = MOST  # dual steps of convex programs after which one problem stops
    cuts: list[Cut] = field(default_factory=list)
    _best: Array | None = None  # (size,) last answer

    @property
    def remembers(self) -> bool:
        """Whether the next problem begins with cuts."""
        return bool(self.cuts)

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[Conditional], Move] | None = None,
    ) -> SolverResult:
        """As `solve_benders`. move: where what is remembered stands now."""
        warm_up(NAME, BendersMemory().solve)
        begin = time.perf_counter()
        deadline = begin + time_limit
        if beyond := instance.features - HOLDS:
            raise UsageError(
                f"method {NAME!r} holds no {' and no '.join(sorted(beyond))}: use branch-and-bound"
            )
        form = conditional_form(instance)
        program = mixed_integer_program(instance, form, deadline)
        if isinstance(program, Impossible) or program is None:
            why = "the time limit came while the program was built"
            why = why if program is None else f"infeasible: {program.why}"
            nothing = Answer(
                None, -np.inf, program is not None, 0, time.perf_counter() - begin, NAME, (why,)
            )
            return judged(instance, nothing, self.gap, self.tolerance)
        read = CutForm(form, program)
        if move is not None:
            self._shift(read, move(form))
        known, state = len(self.cuts), _State()
        sub = Subproblem(program, self.tolerance)
        self._search(instance, form, read, sub, state, deadline)
        if state.unsolved:
            # They are left out of the master, and might be better than all others
            state.bound = min(state.bound, state.left)
            state.infeasible = False
            state.word = f"{state.unsolved} convex programs could not be solved to the end"
        if state.best is None and state.bound > program.numbers.ceiling:
            state.infeasible = True  # nothing in the box costs so much
        tried = f"{sub.count} sets of integers tried, {state.nodes} nodes of masters"
        log = [
            f"{len(program.entities)} integers, {program.size} unknowns, {known} cuts remembered",
            f"{tried}, {sub.steps} dual steps",
            *([state.word] if state.word else []),
        ]
        best = state.best
        answer = Answer(
            x=None if best is None else best[: instance.size],
            assignment=None if best is None else form.alternatives(best),
            bound=state.bound,
            infeasible=state.infeasible and best is None,
            nodes=sub.count,
            time=time.perf_counter() - begin,
            solver=NAME,
            log=tuple(log),
        )
        self._best = self._best if best is None else best
        self.cuts = self.cuts[-_MOST_CUTS:]
        return judged(instance, answer, self.gap, self.tolerance)

    def _shift(self, read: CutForm, move: Move) -> None:
        self.cuts = [cut.moved(read.space, move) for cut in self.cuts]
        if self._best is not None:
            best, there = self._best.copy(), move.variable >= 0
            best[move.variable[there]] = self._best[there]
            self._best = best

    def _search(
        self,
        instance: Instance,
        form: Conditional,
        read: CutForm,
        sub: Subproblem,
        state: _State,
        deadline: float,
    ) -> None:
        """Master and subproblem in turn until bound and cost meet."""
        relaxed, integers = sub.relaxed()
        if np.isposinf(relaxed):
            state.infeasible = True
            return
        state.bound = relaxed
        if self._best is not None:
            integers = np.round(self._best[read.program.entities]).astype(np.int64)
            n = read.program.numbers
            integers = np.clip(integers, n.lowest, n.highest)
        told = 0  # cuts that the master has
        master = Master(form, read.program, relaxed)
        if not self._try(instance, form, read, sub, state, integers):
            state.leave(relaxed)
            master.add(Planes.without(integers), np.inf)
        while True:
            master.add(read.planes(self.cuts[told:]), state.cost)
            told = len(self.cuts)
            if state.best is not None and relative_gap(state.cost, state.bound) <= self.gap:
                return
            left = deadline - time.perf_counter()
            if left <= 0 or sub.steps >= self.work:
                state.word = "a limit came before the proof"
                return
            gap = _SHARE * self.gap
            found = master.solve(gap, left)
            state.nodes += found.nodes
            state.bound = max(state.bound, found.bound)
            if found.infeasible:
                state.infeasible = state.best is None
                state.bound = max(state.bound, state.cost) if state.best is not None else np.inf
                return
            if found.integers is None:
                continue
            if state.best is not None and relative_gap(state.cost, state.bound) <= self.gap:
                return
            again = found.integers.tobytes() in state.tried  # their cut was not good enough
            if again or not self._try(instance, form, read, sub, state, found.integers):
                state.leave(found.bound if again else relaxed)
                master.add(Planes.without(found.integers), state.cost)

    def _try(
        self,
        instance: Instance,
        form: Conditional,
        read: CutForm,
        sub: Subproblem,
        state: _State,
        integers: IntArray,
    ) -> bool:
        """The convex program at some integers: its cut, and its answer if that is the best.

        False if it could not be solved to the end.
        """
        state.tried.add(integers.tobytes())
        x, cut = sub.solve(integers)
        stated = None if x is None else x[: instance.size]
        met = False
        if x is not None and stated is not None:
            met = instance.violation(stated, form.alternatives(x)) <= self.tolerance
        if not met and (cut is None or cut.feasible):  # rounding stopped the solver
            star = read.program.start.copy()
            star[read.program.entities] = integers
            cut = farkas_ray(form, read, integers, star) or cut
        if cut is None:
            return False
        self.cuts.append(cut)
        if met and stated is not None and instance.objective(stated) < state.cost:
            state.best, state.cost = x, instance.objective(stated)
        return True
