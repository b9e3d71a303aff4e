"""Solve mixed-integer convex programs by generalised Benders decomposition, with stored cuts.

The master problem in HiGHS proposes integers that satisfy all cuts (`master`). The compiled solver
of the tree solves the convex subproblem, whose multipliers are a new cut (`cuts`). Both alternate
until the best cost and the bound of the master meet (Geoffrion 1972). Cuts are stored for the next
problem of the same statement, and evaluated at its parameters (X. Lin, arXiv 2406.00780).
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
from climbplan.solvers.benders.benders_cuts import BendersCut, CutEvaluator, CutPlanes
from climbplan.solvers.benders.master import Master
from climbplan.solvers.benders.subproblem import Subproblem
from climbplan.solvers.highs.model import build_linear_model, create_highs, run_highs
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm, build_indicator_form
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift
from climbplan.solvers.mixed_integer.nodes import UNLIMITED
from climbplan.solvers.mixed_integer.presolve import build_mixed_integer_program
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram, ProvedInfeasible
from climbplan.solvers.mixed_integer.warm_up import warm_up_kernels
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    SolverResult,
    judge_answer,
    relative_gap,
)

_MIN_RAY_ENTRY = 1e-12  # entries of a ray below this fraction of the largest are rounding errors


def compute_farkas_cut(
    form: IndicatorForm, evaluator: CutEvaluator, integers: IntArray, x: Array
) -> BendersCut | None:
    """Return a cut that excludes integers (E,), or None.

    HiGHS computes the ray for subproblems that the tree's solver gives up. The cut is evaluated
    from the ray like any other, so it does not rely on the accuracy of HiGHS. `x` (size,) is a
    point nearby.
    """
    program = evaluator.program
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[program.entities] = upper[program.entities] = integers
    active = np.flatnonzero(form.value == lower[form.indicator])
    A = sparse.vstack([form.A, form.C[active]]).tocsr()
    solver = create_highs()
    solver.setOptionValue("presolve", "off")  # which keeps no rays
    solver.passModel(
        build_linear_model(
            np.zeros(form.size),
            A,
            lower=lower,
            upper=upper,
            integer=np.zeros(form.size, bool),
            row_lower=np.concatenate([form.row_lower, form.indicator_lower[active]]),
            row_upper=np.concatenate([form.row_upper, form.indicator_upper[active]]),
        )
    )
    run_highs(solver)
    if solver.getModelStatus() != highspy.HighsModelStatus.kInfeasible:
        return None
    _, has_ray, ray = solver.getDualRay()
    if not has_ray:
        return None
    rows = np.concatenate([np.arange(A.shape[0] - len(active)), A.shape[0] - len(active) + active])
    for y in (np.asarray(ray), -np.asarray(ray)):
        multipliers = np.concatenate([-(A.T @ y), y])  # bounds take what rows pull at each variable
        key = np.concatenate([np.arange(form.size), form.size + rows])
        keep = np.abs(multipliers) > _MIN_RAY_ENTRY * np.abs(multipliers).max(initial=0.0)
        cut = BendersCut(
            key[keep], multipliers[keep] / np.abs(multipliers).max(initial=1e-300), x, False
        )
        plane = evaluator.evaluate([cut])
        deviation = np.where((integers > 0) == plane.star[0], 0.0, plane.slope[0]).sum()
        if plane.bound[0] - deviation > 0.0:
            return cut
    return None


NAME = "benders"
HOLDS = frozenset({"choices", "integers", "implications"})
_MAX_CUTS = 300  # number of cuts stored, the latest ones
_MASTER_GAP_FRACTION = 0.5  # fraction of the gap that the master may leave


def solve_benders(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
) -> SolverResult:
    """Find the global optimum of an instance with binaries, implications and choices.

    The result is deterministic unless the time limit is hit.

    Args:
        instance: Instance without balls, products and smooth rows.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.

    Raises:
        UsageError: The instance has other features, or a direction without cost is not bounded.
    """
    return WarmStartedBenders(gap, tolerance).solve(instance, time_limit)


@dataclass
class _BendersState:
    """State of the search for one problem."""

    incumbent: Array | None = None  # (size,) in the variables of the indicator form
    cost: float = np.inf
    bound: float = -np.inf
    infeasible: bool = False
    tried: set[bytes] = field(default_factory=set)
    num_nodes: int = 0  # nodes of the master problems
    unsolved: int = 0  # number of sets of integers without a sufficient cut
    unsolved_bound: float = np.inf  # lower bound on their cost
    message: str = ""  # reason why the search ended without a proof

    def give_up(self, bound: float) -> None:
        """Give up one set of integers, whose cost is at least `bound`."""
        self.unsolved += 1
        self.unsolved_bound = min(self.unsolved_bound, bound)


@dataclass
class WarmStartedBenders:
    """Solves instances of one statement in turn; each begins with the cuts of those before."""

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    work: int = UNLIMITED  # limit of dual steps for one problem
    cuts: list[BendersCut] = field(default_factory=list)
    _best: Array | None = None  # (size,) last answer

    @property
    def has_warm_start(self) -> bool:
        """Return whether the next problem begins with cuts."""
        return bool(self.cuts)

    def solve(
        self,
        instance: Instance,
        time_limit: float = np.inf,
        move: Callable[[IndicatorForm], HorizonShift] | None = None,
    ) -> SolverResult:
        """Find the global optimum of an instance, as `solve_benders` does.

        Args:
            instance: Instance without balls, products and smooth rows.
            time_limit: Time limit [s].
            move: Function that returns the shift of the horizon since the last call.
        """
        warm_up_kernels(NAME, WarmStartedBenders().solve)
        begin = time.perf_counter()
        deadline = begin + time_limit
        if beyond := instance.features - HOLDS:
            raise UsageError(
                f"method {NAME!r} holds no {' and no '.join(sorted(beyond))}: use branch-and-bound"
            )
        form = build_indicator_form(instance)
        program = build_mixed_integer_program(instance, form, deadline)
        if isinstance(program, ProvedInfeasible) or program is None:
            message = "the time limit came while the program was built"
            message = message if program is None else f"infeasible: {program.why}"
            answer_without_search = Answer(
                None, -np.inf, program is not None, 0, time.perf_counter() - begin, NAME, (message,)
            )
            return judge_answer(instance, answer_without_search, self.gap, self.tolerance)
        evaluator = CutEvaluator(form, program)
        if move is not None:
            self._shift_horizon(evaluator, move(form))
        num_stored_cuts, state = len(self.cuts), _BendersState()
        subproblem = Subproblem(program, self.tolerance)
        self._alternate(instance, form, evaluator, subproblem, state, deadline)
        if state.unsolved:
            # The master excludes them, and they might be better than all others
            state.bound = min(state.bound, state.unsolved_bound)
            state.infeasible = False
            state.message = f"{state.unsolved} convex programs could not be solved to the end"
        if state.incumbent is None and state.bound > program.data.max_cost:
            state.infeasible = True  # nothing in the box costs so much
        best = state.incumbent
        answer = Answer(
            x=None if best is None else best[: instance.size],
            assignment=None if best is None else form.decode_alternatives(best),
            bound=state.bound,
            infeasible=state.infeasible and best is None,
            nodes=subproblem.num_solved,
            time=time.perf_counter() - begin,
            solver=NAME,
            log=_build_log(program, num_stored_cuts, subproblem, state),
        )
        self._best = self._best if best is None else best
        self.cuts = self.cuts[-_MAX_CUTS:]
        return judge_answer(instance, answer, self.gap, self.tolerance)

    def _shift_horizon(self, evaluator: CutEvaluator, shift: HorizonShift) -> None:
        """Shift the stored cuts and the last answer."""
        self.cuts = [cut.shift(evaluator.space, shift) for cut in self.cuts]
        if self._best is not None:
            best, remains = self._best.copy(), shift.variable >= 0
            best[shift.variable[remains]] = self._best[remains]
            self._best = best

    def _alternate(
        self,
        instance: Instance,
        form: IndicatorForm,
        evaluator: CutEvaluator,
        subproblem: Subproblem,
        state: _BendersState,
        deadline: float,
    ) -> None:
        """Alternate master and subproblem until bound and cost meet."""
        relaxation_bound, integers = subproblem.solve_relaxation()
        if np.isposinf(relaxation_bound):
            state.infeasible = True
            return
        state.bound = relaxation_bound
        if self._best is not None:
            integers = np.round(self._best[evaluator.program.entities]).astype(np.int64)
            n = evaluator.program.data
            integers = np.clip(integers, n.root_low, n.root_high)
        num_added = 0  # number of cuts in the master
        master = Master(form, evaluator.program, relaxation_bound)
        if not self._solve_subproblem(instance, form, evaluator, subproblem, state, integers):
            state.give_up(relaxation_bound)
            master.add_cuts(CutPlanes.exclude(integers), np.inf)
        while True:
            master.add_cuts(evaluator.evaluate(self.cuts[num_added:]), state.cost)
            num_added = len(self.cuts)
            if state.incumbent is not None and relative_gap(state.cost, state.bound) <= self.gap:
                return
            time_left = deadline - time.perf_counter()
            if time_left <= 0 or subproblem.num_dual_steps >= self.work:
                state.message = "a limit came before the proof"
                return
            gap = _MASTER_GAP_FRACTION * self.gap
            answer = master.solve(gap, time_left)
            state.num_nodes += answer.nodes
            state.bound = max(state.bound, answer.bound)
            if answer.infeasible:
                state.infeasible = state.incumbent is None
                state.bound = (
                    max(state.bound, state.cost) if state.incumbent is not None else np.inf
                )
                return
            if answer.integers is None:
                continue
            if state.incumbent is not None and relative_gap(state.cost, state.bound) <= self.gap:
                return
            is_repeated = answer.integers.tobytes() in state.tried  # their cut was not sufficient
            if is_repeated or not self._solve_subproblem(
                instance, form, evaluator, subproblem, state, answer.integers
            ):
                state.give_up(answer.bound if is_repeated else relaxation_bound)
                master.add_cuts(CutPlanes.exclude(answer.integers), state.cost)

    def _solve_subproblem(
        self,
        instance: Instance,
        form: IndicatorForm,
        evaluator: CutEvaluator,
        subproblem: Subproblem,
        state: _BendersState,
        integers: IntArray,
    ) -> bool:
        """Solve the subproblem of some integers; store its cut, and its solution if it is the best.

        Returns:
            False if no cut was found.
        """
        state.tried.add(integers.tobytes())
        x, cut = subproblem.solve(integers)
        stated = None if x is None else x[: instance.size]
        is_feasible = False
        if x is not None and stated is not None:
            is_feasible = instance.violation(stated, form.decode_alternatives(x)) <= self.tolerance
        if not is_feasible and (cut is None or cut.feasible):  # rounding errors stopped the solver
            star = evaluator.program.start.copy()
            star[evaluator.program.entities] = integers
            cut = compute_farkas_cut(form, evaluator, integers, star) or cut
        if cut is None:
            return False
        self.cuts.append(cut)
        if is_feasible and stated is not None and instance.objective(stated) < state.cost:
            state.incumbent, state.cost = x, instance.objective(stated)
        return True


def _build_log(
    program: MixedIntegerProgram, num_stored_cuts: int, subproblem: Subproblem, state: _BendersState
) -> tuple[str, ...]:
    """Return the lines about sizes and effort."""
    integers, size = len(program.entities), program.size
    sets, nodes = subproblem.num_solved, state.num_nodes
    steps = subproblem.num_dual_steps
    lines = [
        f"{integers} integers, {size} unknowns, {num_stored_cuts} cuts remembered",
        f"{sets} sets of integers tried, {nodes} nodes of masters, {steps} dual steps",
    ]
    return (*lines, state.message) if state.message else tuple(lines)
