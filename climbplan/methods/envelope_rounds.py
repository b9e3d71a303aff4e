"""Any program as a mixed-integer convex one, in rounds of finer envelopes (`micp`).

Products become piecewise McCormick envelopes on grids of one factor each, implications and choices
big-M or convex-hull rows. The relaxation gives a bound and integers; the exact program pinned at
these integers gives an incumbent, checked on the statement. Where the gap between both is too wide,
the incumbent's cost cuts off parts of the box (Duran-Grossmann squares of the cost can be no larger
than it), and the next round has twice the pieces on what is left.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.strategy import Candidate
from climbplan.methods.pinning import at_point, solve_candidate
from climbplan.program.box import Box, propagated_box
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem
from climbplan.reformulations.disjunctions import BigM, ConvexHull
from climbplan.reformulations.grids import Encoding, Partition, pieces, uniform
from climbplan.reformulations.mccormick import Enveloped, EnvelopeForm, McCormick
from climbplan.solvers.ipopt.mpcc import STRAIGHT, solve_mpcc
from climbplan.solvers.registry import require
from climbplan.solvers.result import Answer, SolverResult, judged, relative_gap
from climbplan.solvers.separable_cost import separable_cost

NAME = "micp"
Disjunction = Literal["big-m", "hull"]
# `scip` alone holds no stated binaries; its bilinear model holds everything.
MICP_SOLVERS = {"highs": "highs", "scip": "minlp-scip", "gurobi": "gurobi"}
_MARGIN = 1e-6  # relative: room that bounds leave solvers, which work to 1e-6 in a row
_LEAST_WIDTH = 1e-4  # relative: narrower ranges are not cut into pieces
_INNER_GAP = 0.5  # share of the gap asked for that one mixed-integer program may leave


@dataclass(frozen=True)
class EnvelopeOptions:
    """How a program becomes a mixed-integer convex one."""

    solver: str = "highs"
    pieces: int = 6  # of each grid in the first round, where the problem gives no partition
    rounds: int = 2  # each doubles the pieces on the box that the incumbent leaves
    disjunctions: Disjunction = "big-m"
    encoding: Encoding = "unary"
    grid: McCormick | None = None  # given pieces on the stated bounds: one round, no other ones


def solve_micp(
    problem: Problem,
    instance: Instance,
    options: EnvelopeOptions | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
    form: EnvelopeForm | None = None,
) -> SolverResult:
    """Solve an instance by envelopes, disjunctive rows and a mixed-integer solver.

    form: of the options' grid, if it was made for another instance of the program.

    Smooth rows are left to the program that is pinned at the relaxation's integers.
    The bound is that of the relaxation, valid unless the problem's own partitions leave parts of
    the box out (then it is -inf). Raises UsageError where a factor of a product or the variables of
    an implication have no bounds, and for a solver that is not one of `MICP_SOLVERS`.
    """
    options = options or EnvelopeOptions()
    begin = time.perf_counter()
    best: SolverResult | None = None
    bound, nodes, log = -np.inf, 0, list[str]()
    empty = False  # a relaxation was found to be infeasible
    count = options.rounds if instance.products.count and options.grid is None else 1
    if options.grid is not None and form is None:
        form = options.grid.form(replace(instance, smooth=None))
    for number in range(count):
        left = time_limit - (time.perf_counter() - begin)
        if left <= 0:
            log.append("time limit")
            break
        cut = instance if best is None else below_cost(instance, best)
        box = _roomy(propagated_box(cut))
        if (box.lower > box.upper).any():
            empty = True
            log.append(f"round {number + 1}: no point within the bounds")
            break
        if form is None:
            relaxed = _relaxed(problem, cut, box, options, number)
        else:
            relaxed = _disjoined(form.at(replace(instance, smooth=None)), options)
        left = time_limit - (time.perf_counter() - begin)
        if left <= 0:
            log.append(f"round {number + 1}: the time was over when its program was made")
            break
        found = _solve(relaxed.instance, options.solver, _INNER_GAP * gap, left)
        nodes += found.nodes
        empty = relaxed.relaxation and found.status == "infeasible"
        if relaxed.relaxation and not empty:
            bound = max(bound, found.bound)
        log.append(f"round {number + 1}: {found.status}, bound {found.bound:.6g}")
        if found.x is None:
            break
        guess = relaxed.candidate(instance, found.x)
        better = _polished(instance, guess, gap, time_limit - (time.perf_counter() - begin))
        if better is not None and (best is None or _cost(better) < _cost(best)):
            best = better
        if best is not None and relative_gap(_cost(best), bound) <= gap:
            break
    infeasible = False
    if empty and best is None:
        # Envelopes on narrow boxes are badly scaled: such a claim is tried on the exact program.
        left = max(time_limit - (time.perf_counter() - begin), 0.1)
        stated = replace(instance, smooth=None)
        second = require("minlp-scip").load()(stated, gap=gap, time_limit=left)
        log += ["infeasible? asked SCIP on the exact program", *second.log]
        infeasible = second.status == "infeasible"
        whole = second.x is not None and instance.smooth is None
        best, bound = (second if whole else None), second.bound
    answer = Answer(
        x=None if best is None else best.x,
        bound=bound,
        infeasible=infeasible,
        nodes=nodes,
        time=time.perf_counter() - begin,
        solver=f"{NAME} ({options.solver})",
        log=tuple(log),
        assignment=None if best is None else best.assignment,
    )
    return judged(instance, answer, gap, tolerance)


@dataclass(frozen=True)
class _Relaxed:
    """A mixed-integer convex instance, and how its solutions are read."""

    instance: Instance
    relaxation: bool
    alternatives: tuple[IntArray, ...]  # columns of the binaries of each choice

    def candidate(self, source: Instance, x: Array) -> Candidate:
        chosen = [int(np.argmax(x[group])) for group in self.alternatives]
        return at_point(x[: source.size].copy(), np.array(chosen, np.int64))


def _relaxed(
    problem: Problem, instance: Instance, box: Box, options: EnvelopeOptions, number: int
) -> _Relaxed:
    # Both envelopes and big-M constants read the bounds: the tightest valid ones.
    tight = replace(
        instance,
        lower=np.maximum(instance.lower, box.lower),
        upper=np.minimum(instance.upper, box.upper),
    )
    # Smooth rows have no envelopes: without them it is a relaxation all the same
    tight, partitions = replace(tight, smooth=None), tuple[Partition, ...]()
    if instance.products.count:
        partitions = default_partitions(problem, instance, box, options.pieces, 2**number)
    return _disjoined(McCormick(partitions, options.encoding).apply(tight), options)


def _disjoined(enveloped: Enveloped, options: EnvelopeOptions) -> _Relaxed:
    disjunctions = BigM() if options.disjunctions == "big-m" else ConvexHull()
    disjoined = disjunctions.apply(enveloped.instance)
    return _Relaxed(disjoined.instance, enveloped.relaxation, disjoined.binaries)


def default_partitions(
    problem: Problem, instance: Instance, box: Box, count: int = 6, finer: int = 1
) -> tuple[Partition, ...]:
    """A grid on one factor of each product without an integer factor.

    The problem's own partitions first, then the factors that most products share. count: pieces
    where the problem gives none. finer: factor on all numbers of pieces. Raises UsageError naming
    a factor without bounds.
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
        own = cut * finer if isinstance(cut, int) else _finer(np.asarray(cut, float), finer)
        cuts |= {i: own for i in range(variable.start, variable.stop) if i in factors}
    while uncovered := [pair for pair in open_pairs if not (set(pair) & cuts.keys())]:
        shared = Counter(i for pair in uncovered for i in set(pair))
        width = box.upper - box.lower
        # Of equally shared factors the narrower one has the tighter envelopes.
        cuts[min(shared, key=lambda i: (-shared[i], width[i], i))] = count * finer
    for i in sorted(factors):
        if not np.isfinite(box.upper[i] - box.lower[i]) and not isinstance(cuts.get(i), np.ndarray):
            raise UsageError(
                f"problem {problem.name!r}: {variable_name(problem, i)} is a factor of a product "
                "and nothing bounds it: give it bounds, or a partition with knots"
            )
    return tuple(
        _partition(i, cut, float(box.lower[i]), float(box.upper[i]))
        for i, cut in sorted(cuts.items())
        if not isinstance(cut, int)
        or box.upper[i] - box.lower[i] > _LEAST_WIDTH * max(1.0, abs(box.upper[i]))
    )


def variable_name(problem: Problem, index: int) -> str:
    """`rate[3]`: the entry of a block that stands at an index of x."""
    for name, variable in problem.program.variables.items():
        if variable.start <= index < variable.stop:
            if not variable.shape:
                return name
            entry = np.unravel_index(index - variable.start, variable.shape)
            return f"{name}[{', '.join(str(int(k)) for k in entry)}]"
    raise IndexError(index)


def below_cost(instance: Instance, incumbent: SolverResult) -> Instance:
    """The instance with rows that hold wherever the cost is at most the incumbent's.

    The cost is sum u_j^2 / 2 + slope'x + constant with u = U x + offset, so no u_j^2 / 2 is larger
    than the incumbent's cost less the smallest value of the rest.
    """
    cost = separable_cost(instance)
    box = propagated_box(instance)
    slope = sparse.csr_matrix(cost.slope[None])
    slope.eliminate_zeros()
    rest = cost.constant + float(box.interval(slope).lower[0])
    most = _cost(incumbent) - rest
    if not np.isfinite(most) or most < 0 or not len(cost.offset):
        return instance
    reach = np.full(len(cost.offset), np.sqrt(2 * most) * (1 + 1e-9))
    empty = sparse.csr_matrix((len(reach), instance.Q.shape[1]))
    return replace(
        instance,
        A=sparse.vstack([instance.A, cost.U]).tocsr(),
        Q=sparse.vstack([instance.Q, empty]).tocsr(),
        row_lower=np.concatenate([instance.row_lower, -reach - cost.offset]),
        row_upper=np.concatenate([instance.row_upper, reach - cost.offset]),
    )


def _roomy(box: Box) -> Box:
    """The box, a little wider than rounding and the tolerances of solvers; crossed bounds stay."""
    crossed = (box.lower > box.upper).any()
    if crossed:
        return box
    low = box.lower - _MARGIN * np.maximum(1.0, np.abs(box.lower))
    high = box.upper + _MARGIN * np.maximum(1.0, np.abs(box.upper))
    return Box(low, high, box.products)


def _partition(i: int, cut: int | Array, low: float, high: float) -> Partition:
    ends = uniform(low, high, cut) if isinstance(cut, int) else pieces(cut)
    # Pieces over the propagated box hold every feasible point, whatever the stated bounds are.
    covering = isinstance(cut, int)
    return Partition(np.array([i]), ends[:, :1], ends[:, 1:], covering)


def _finer(knots: Array, factor: int) -> Array:
    at = np.arange(0, len(knots) - 1 + 0.5 / factor, 1 / factor)
    return np.interp(at, np.arange(len(knots)), knots)


def _solve(instance: Instance, solver: str, gap: float, time_limit: float) -> SolverResult:
    if solver not in MICP_SOLVERS:
        known = ", ".join(MICP_SOLVERS)
        raise UsageError(f"method {NAME!r}: no solver {solver!r}, expected one of {known}")
    return require(MICP_SOLVERS[solver]).load()(instance, gap=gap, time_limit=time_limit)


def _polished(
    instance: Instance, guess: Candidate, gap: float, time_limit: float
) -> SolverResult | None:
    """The exact program with the guess's integers; where it fails, complementarity from there."""
    found = solve_candidate(instance, guess, gap=gap, time_limit=max(time_limit, 0.1))
    if found.x is None and instance.products.count:
        found = solve_mpcc(
            instance,
            gap,
            max(time_limit, 0.1),
            start=guess.start,
            assignment=guess.alternatives,
            homotopy=STRAIGHT,
        )
    return None if found.x is None else found


def _cost(result: SolverResult) -> float:
    assert result.objective is not None
    return result.objective
