"""Solve any program as a mixed-integer convex one, in rounds of finer envelopes (`mccormick`).

Products become piecewise McCormick envelopes on grids of one factor each, implications and choices
big-M or convex-hull rows. The relaxation gives a bound and integers. The exact program at these
integers gives an incumbent, checked on the statement. If the gap is too wide, the incumbent's cost
cuts off parts of the box, since no square of the cost can exceed it, and the next round has twice
the pieces on the rest.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.strategy import Candidate
from climbplan.methods.candidate_solving import candidate_at, solve_candidate
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem
from climbplan.progress import report_search
from climbplan.reformulations.disjunctions import BigM, ConvexHull
from climbplan.reformulations.grids import Encoding, Partition, pieces, uniform
from climbplan.reformulations.mccormick import EnvelopedInstance, EnvelopeForm, McCormick
from climbplan.solvers.ipopt.mpcc import STRAIGHT, solve_mpcc
from climbplan.solvers.registry import require
from climbplan.solvers.result import Answer, SolverResult, judge_answer, relative_gap
from climbplan.solvers.separable_cost import factor_cost

NAME = "mccormick"
Disjunction = Literal["big-m", "hull"]
# Backend `scip` supports no stated binaries; its bilinear model supports everything.
MICP_SOLVERS = {"highs": "highs", "scip": "minlp-scip", "gurobi": "gurobi"}
_MARGIN = 1e-6  # relative margin of bounds for solvers that work to 1e-6 in a row
_MIN_WIDTH = 1e-4  # relative width below which ranges are not divided into pieces
_INNER_GAP = 0.5  # fraction of the gap that one mixed-integer program may leave


@dataclass(frozen=True)
class EnvelopeOptions:
    """Options of the mixed-integer convex relaxation."""

    solver: str = "highs"
    pieces: int = 6  # of each grid in the first round, where the problem has no partition
    rounds: int = 2  # each doubles the pieces on the box that the incumbent's cost leaves
    disjunctions: Disjunction = "big-m"
    encoding: Encoding = "unary"
    grid: McCormick | None = None  # fixed pieces on the stated bounds, for a single round


def solve_micp(
    problem: Problem,
    instance: Instance,
    options: EnvelopeOptions | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
    *,
    form: EnvelopeForm | None = None,
) -> SolverResult:
    """Solve an instance by envelopes, disjunctive rows and a mixed-integer solver.

    Smooth rows enter only the program at the relaxation's integers. The bound is that of the
    relaxation. It is valid unless the problem's own partitions leave parts of the box out, in which
    case it is -inf.

    Args:
        problem: The problem.
        instance: Its instance.
        options: Options of the relaxation.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        form: Prepared envelopes of the options' grid.

    Raises:
        UsageError: A factor of a product or the variables of an implication have no bounds, or the
            solver is unknown.
    """
    begin = time.perf_counter()
    options = options or EnvelopeOptions()
    num_rounds = options.rounds if instance.products.count and options.grid is None else 1
    if options.grid is not None and form is None:
        form = options.grid.form(replace(instance, smooth=None))
    search = _EnvelopeSearch(problem, instance, options, form, gap, begin, time_limit)
    for index in range(num_rounds):
        if not search.run_round(index):
            break
    infeasible = search.is_infeasible and search.best is None and search.confirm_infeasibility()
    best = search.best
    answer = Answer(
        x=None if best is None else best.x,
        bound=search.bound,
        infeasible=infeasible,
        nodes=search.nodes,
        time=time.perf_counter() - begin,
        solver=f"{NAME} ({options.solver})",
        log=tuple(search.log),
        assignment=None if best is None else best.assignment,
    )
    return judge_answer(instance, answer, gap, tolerance)


@dataclass
class _EnvelopeSearch:
    """An instance that is solved in rounds, with incumbent and bound so far."""

    problem: Problem
    instance: Instance
    options: EnvelopeOptions
    form: EnvelopeForm | None
    gap: float
    begin: float  # [s] of `time.perf_counter`
    time_limit: float  # [s] from then on
    best: SolverResult | None = None
    bound: float = -np.inf
    nodes: int = 0
    log: list[str] = field(default_factory=list)
    is_infeasible: bool = False  # a relaxation was found to be infeasible

    @property
    def _time_left(self) -> float:
        return self.time_limit - (time.perf_counter() - self.begin)

    def run_round(self, index: int) -> bool:
        """Solve the relaxation of a round, and the exact program at its integers.

        Returns:
            False if no round can improve the result: the gap is closed, nothing is feasible, the
            relaxation has no solution, or the time is over.
        """
        if self._time_left <= 0:
            self.log.append("time limit")
            return False
        instance, name = self.instance, f"round {index + 1}"
        restricted = instance if self.best is None else restrict_to_cost(instance, self.best)
        box = _widen_box(propagate_box(restricted))
        if (box.lower > box.upper).any():
            self.is_infeasible = True
            self.log.append(f"{name}: no point within the bounds")
            return False
        if self.form is None:
            relaxed = _build_relaxation(self.problem, restricted, box, self.options, index)
        else:
            convex_instance = replace(instance, smooth=None)
            relaxed = _apply_disjunctions(self.form.at(convex_instance), self.options)
        time_left = self._time_left
        if time_left <= 0:
            self.log.append(f"{name}: the time was over when its program was made")
            return False
        inner_gap = _INNER_GAP * self.gap
        result = _solve_relaxation(relaxed.instance, self.options.solver, inner_gap, time_left)
        self.nodes += result.nodes
        self.is_infeasible = relaxed.relaxation and result.status == "infeasible"
        if relaxed.relaxation and not self.is_infeasible:
            self.bound = max(self.bound, result.bound)
        self.log.append(f"{name}: {result.status}, bound {result.bound:.6g}")
        self._report()
        if result.x is None:
            return False
        guess = relaxed.extract_candidate(instance, result.x)
        self._improve(_polish(instance, guess, self.gap, self._time_left))
        self._report()
        return self.best is None or relative_gap(_read_cost(self.best), self.bound) > self.gap

    def _report(self) -> None:
        report_search(None if self.best is None else _read_cost(self.best), self.bound)

    def _improve(self, point: SolverResult | None) -> None:
        """Take a point as incumbent if it is cheaper."""
        if point is not None and (self.best is None or _read_cost(point) < _read_cost(self.best)):
            self.best = point

    def confirm_infeasibility(self) -> bool:
        """Return whether SCIP finds the exact program infeasible, else take its solution and bound.

        Envelopes on narrow boxes are badly scaled and alone prove nothing.
        """
        exact_instance = replace(self.instance, smooth=None)
        result = require("minlp-scip").load()(
            exact_instance, gap=self.gap, time_limit=max(self._time_left, 0.1)
        )
        self.log += ["infeasible? asked SCIP on the exact program", *result.log]
        is_usable = result.x is not None and self.instance.smooth is None
        self.best, self.bound = (result if is_usable else None), result.bound
        return result.status == "infeasible"


@dataclass(frozen=True)
class _RelaxedProgram:
    """A mixed-integer convex instance, and the columns of its choices."""

    instance: Instance
    relaxation: bool
    alternatives: tuple[IntArray, ...]  # columns of the binaries of each choice

    def extract_candidate(self, source: Instance, x: Array) -> Candidate:
        """Return the candidate of a solution."""
        chosen = [int(np.argmax(x[group])) for group in self.alternatives]
        return candidate_at(x[: source.size].copy(), np.array(chosen, np.int64))


def _build_relaxation(
    problem: Problem, instance: Instance, box: VariableBox, options: EnvelopeOptions, number: int
) -> _RelaxedProgram:
    # Envelopes and big-M constants depend on the bounds, so these are tightened.
    """Build the relaxation of one round."""
    tight = replace(
        instance,
        lower=np.maximum(instance.lower, box.lower),
        upper=np.minimum(instance.upper, box.upper),
    )
    # Smooth rows have no envelopes; without them the program is still a relaxation
    tight, partitions = replace(tight, smooth=None), tuple[Partition, ...]()
    if instance.products.count:
        partitions = build_default_partitions(problem, instance, box, options.pieces, 2**number)
    return _apply_disjunctions(McCormick(partitions, options.encoding).apply(tight), options)


def _apply_disjunctions(enveloped: EnvelopedInstance, options: EnvelopeOptions) -> _RelaxedProgram:
    """Replace implications and choices by rows with binaries."""
    disjunctions = BigM() if options.disjunctions == "big-m" else ConvexHull()
    disjoined = disjunctions.apply(enveloped.instance)
    return _RelaxedProgram(disjoined.instance, enveloped.relaxation, disjoined.binaries)


def build_default_partitions(
    problem: Problem, instance: Instance, box: VariableBox, count: int = 6, finer: int = 1
) -> tuple[Partition, ...]:
    """Build a grid on one factor of each product without an integer factor.

    The problem's own partitions come first, then the factors that most products share.

    Args:
        problem: The problem.
        instance: Its instance.
        box: Ranges of variables.
        count: Number of pieces where the problem has no partition.
        finer: Factor of all numbers of pieces.

    Raises:
        UsageError: A factor has no bounds.
    """
    products = instance.products
    integer = instance.integer
    open_pairs = [
        (int(i), int(j))
        for i, j in zip(products.first, products.second, strict=True)
        if not integer[i] and not integer[j]
    ]
    factors = {i for pair in open_pairs for i in pair}
    cuts: dict[int, int | Array] = {}
    for name, cut in problem.partitions.items():
        variable = problem.program.variables[name]
        partition = (
            cut * finer if isinstance(cut, int) else _refine_knots(np.asarray(cut, float), finer)
        )
        cuts |= {i: partition for i in range(variable.start, variable.stop) if i in factors}
    while uncovered := [pair for pair in open_pairs if not (set(pair) & cuts.keys())]:
        shared = Counter(i for pair in uncovered for i in set(pair))
        width = box.upper - box.lower
        # Of equally shared factors the narrower one has the tighter envelopes.
        cuts[min(shared, key=lambda i: (-shared[i], width[i], i))] = count * finer
    for i in sorted(factors):
        if not np.isfinite(box.upper[i] - box.lower[i]) and not isinstance(cuts.get(i), np.ndarray):
            raise UsageError(
                f"problem {problem.name!r}: {format_variable_name(problem, i)} is a factor of a "
                "product and nothing bounds it: give it bounds, or a partition with knots"
            )
    return tuple(
        _build_partition(i, cut, float(box.lower[i]), float(box.upper[i]))
        for i, cut in sorted(cuts.items())
        if not isinstance(cut, int)
        or box.upper[i] - box.lower[i] > _MIN_WIDTH * max(1.0, abs(box.upper[i]))
    )


def format_variable_name(problem: Problem, index: int) -> str:
    """Return the name of an entry of x, such as `rate[3]`."""
    for name, variable in problem.program.variables.items():
        if variable.start <= index < variable.stop:
            if not variable.shape:
                return name
            entry = np.unravel_index(index - variable.start, variable.shape)
            return f"{name}[{', '.join(str(int(k)) for k in entry)}]"
    raise IndexError(index)


def restrict_to_cost(instance: Instance, incumbent: SolverResult) -> Instance:
    """Add rows that hold wherever the cost is at most the incumbent's.

    The cost is sum u_j^2 / 2 + slope'x + constant with u = U x + offset. So no u_j^2 / 2 exceeds
    the incumbent's cost minus the smallest value of the rest.
    """
    cost = factor_cost(instance)
    box = propagate_box(instance)
    slope = sparse.csr_matrix(cost.slope[None])
    slope.eliminate_zeros()
    min_rest = cost.constant + float(box.interval(slope).lower[0])
    max_square = _read_cost(incumbent) - min_rest
    if not np.isfinite(max_square) or max_square < 0 or not len(cost.offset):
        return instance
    max_abs = np.full(len(cost.offset), np.sqrt(2 * max_square) * (1 + 1e-9))
    empty = sparse.csr_matrix((len(max_abs), instance.Q.shape[1]))
    return replace(
        instance,
        A=sparse.vstack([instance.A, cost.U]).tocsr(),
        Q=sparse.vstack([instance.Q, empty]).tocsr(),
        row_lower=np.concatenate([instance.row_lower, -max_abs - cost.offset]),
        row_upper=np.concatenate([instance.row_upper, max_abs - cost.offset]),
    )


def _widen_box(box: VariableBox) -> VariableBox:
    """Widen a box by rounding errors and the tolerances of solvers; crossed bounds stay."""
    crossed = (box.lower > box.upper).any()
    if crossed:
        return box
    low = box.lower - _MARGIN * np.maximum(1.0, np.abs(box.lower))
    high = box.upper + _MARGIN * np.maximum(1.0, np.abs(box.upper))
    return VariableBox(low, high, box.products)


def _build_partition(i: int, cut: int | Array, low: float, high: float) -> Partition:
    """Build the grid of one factor."""
    ends = uniform(low, high, cut) if isinstance(cut, int) else pieces(cut)
    # Pieces over the propagated box contain every feasible point, whatever the stated bounds.
    covering = isinstance(cut, int)
    return Partition(np.array([i]), ends[:, :1], ends[:, 1:], covering)


def _refine_knots(knots: Array, factor: int) -> Array:
    """Refine knots by interpolation."""
    position = np.arange(0, len(knots) - 1 + 0.5 / factor, 1 / factor)
    return np.interp(position, np.arange(len(knots)), knots)


def _solve_relaxation(
    instance: Instance, solver: str, gap: float, time_limit: float
) -> SolverResult:
    """Solve the relaxation with a named solver."""
    if solver not in MICP_SOLVERS:
        names = ", ".join(MICP_SOLVERS)
        raise UsageError(f"method {NAME!r}: no solver {solver!r}, expected one of {names}")
    return require(MICP_SOLVERS[solver]).load()(instance, gap=gap, time_limit=time_limit)


def _polish(
    instance: Instance, guess: Candidate, gap: float, time_limit: float
) -> SolverResult | None:
    """Solve the exact program at the guess's integers; where that fails, by complementarity."""
    result = solve_candidate(instance, guess, gap=gap, time_limit=max(time_limit, 0.1))
    if result.x is None and instance.products.count:
        result = solve_mpcc(
            instance,
            gap,
            max(time_limit, 0.1),
            start=guess.start,
            assignment=guess.alternatives,
            homotopy=STRAIGHT,
        )
    return None if result.x is None else result


def _read_cost(result: SolverResult) -> float:
    """Return the cost of a result with a point."""
    assert result.objective is not None
    return result.objective
