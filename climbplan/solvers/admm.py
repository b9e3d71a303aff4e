"""ADMM between a mixed-integer and a nonlinear block, Algorithm 3 of chapter 6.4.

The printed dual update compares a vector with itself; here it is w <- w + var1 - var2. Without
convexity nothing guarantees convergence. The best iterate by the exact check is therefore kept, and
the program at fixed integers polishes it.

Chapter and algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.admm import AdmmSplit, Norm, Relaxation, SplitInstance
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.nlp_form import Consensus
from climbplan.solvers.ipopt.instances import ITERATIONS, TOLERANCE, solve_fixed_integers, solve_nlp
from climbplan.solvers.result import MIN_OBJECTIVE_SCALE, Answer, SolverResult, judge_answer

NAME = "admm"
# Solves a mixed-integer block without products: instance -> variables, None without a solution.
# Integers, implications and choices are as stated.
MixedIntegerSolver = Callable[[Instance], Array | None]


@dataclass(frozen=True)
class AdmmOptions:
    """Options of the iteration."""

    penalty: float = 10.0  # for a disagreement of a whole span, in units of the cost at the start
    growth: float = 1.3  # factor of the weights from one iteration to the next, rho
    iterations: int = 15
    residual: float = 1e-3  # disagreement at which to stop, as a fraction of the variables' spans
    norm: Norm = "l2"
    share: float = 1.0  # weight of the cost against the consensus in the mixed-integer block
    freeze_after: int | None = None  # iterations after which the integers are fixed
    mixed_integer_gap: float = 1e-3  # relative gap of the mixed-integer block
    stop_when_feasible: bool = False  # at the first iterate that passes the exact check
    weight: Array | None = None  # (n,) weight of each variable, penalty / span^2 if missing


@dataclass(frozen=True)
class AdmmStep:
    """Record of one iteration; residuals are fractions of the variables' spans."""

    mean_residual: float
    max_residual: float
    dual_residual: float  # largest change of the nonlinear block's point
    violation: float  # of the instance at the nonlinear block's point, exact check
    objective: float
    mixed_integer_seconds: float
    nonlinear_seconds: float
    new_integers: bool


@dataclass(frozen=True)
class AdmmResult:
    """The answer and the record of its iterations."""

    result: SolverResult
    steps: tuple[AdmmStep, ...]
    best: int | None  # iteration (from 0) whose iterate was polished


@dataclass(frozen=True)
class _AdmmIterate:
    """A point of the nonlinear block and its quality."""

    x: Array
    assignment: IntArray
    violation: float
    objective: float
    number: int

    def rank(self, tolerance: float) -> tuple[float, float]:
        """Return the rank, smaller is better: feasible ones by cost, others by violation."""
        return (max(self.violation, tolerance), self.objective)


def solve_admm(
    instance: Instance,
    mixed_integer: MixedIntegerSolver,
    start: Array | None = None,
    relax: Relaxation | None = None,
    options: AdmmOptions | None = None,
    *,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    polish: bool = True,
) -> AdmmResult:
    """Find a feasible point of an instance by consensus of its two blocks.

    The status is "feasible" or "limit"; ADMM proves nothing.

    Args:
        instance: The instance.
        mixed_integer: Solver of the mixed-integer block.
        start: (n,) first point of the nonlinear block; None begins without a consensus term.
        relax: Envelopes of products in the mixed-integer block.
        options: Options of the iteration.
        gap: Not used to stop.
        time_limit: Time limit [s], checked between iterations and in the nonlinear block.
        tolerance: Largest violation of any constraint.
        polish: Whether to solve the program at fixed integers from the best iterate.
    """
    options = options or AdmmOptions()
    begin = time.monotonic()
    deadline = begin + time_limit
    split = (AdmmSplit() if relax is None else AdmmSplit(relax)).apply(instance)
    weight = None if start is None else _compute_weights(split, options, start)
    consensus = _ConsensusState(split, options, np.zeros(instance.size), start, weight)
    steps: list[AdmmStep] = []
    best: _AdmmIterate | None = None
    for number in range(options.iterations):
        if time.monotonic() > deadline:
            break
        iteration = consensus.advance(mixed_integer, number, deadline)
        if iteration is None:
            break
        iterate, step = iteration
        steps.append(step)
        if best is None or iterate.rank(tolerance) < best.rank(tolerance):
            best = iterate
        is_feasible = iterate.violation <= tolerance
        if step.max_residual <= options.residual or (options.stop_when_feasible and is_feasible):
            break
    x, log = _polish_best(instance, best, steps, tolerance, deadline if polish else None)
    answer = Answer(
        x=x,
        bound=-np.inf,
        infeasible=False,
        nodes=len(steps),
        time=time.monotonic() - begin,
        solver=NAME,
        log=tuple(log),
        assignment=None if best is None else best.assignment,
    )
    result = judge_answer(instance, answer, gap, tolerance)
    return AdmmResult(result, tuple(steps), None if best is None else best.number)


@dataclass
class _ConsensusState:
    """Weights, scaled duals and the last points of both blocks."""

    split: SplitInstance
    options: AdmmOptions
    dual: Array  # (n,)
    nonlinear_point: Array | None  # (n,)
    weight: Array | None  # (n,) None until the cost's scale is known
    integers: Array | None = None  # (n,) of the mixed-integer block, 0 for other variables

    def advance(
        self, mixed_integer: MixedIntegerSolver, number: int, deadline: float
    ) -> tuple[_AdmmIterate, AdmmStep] | None:
        """Minimise over one block after the other, then update duals and weights.

        Returns:
            The nonlinear block's point and the record of iteration `number`; None if the
            mixed-integer block has no solution.
        """
        split, options, instance = self.split, self.options, self.split.instance
        time_begin = time.monotonic()
        frozen = options.freeze_after is not None and number >= options.freeze_after
        block = split.build_mixed_integer_block(
            _build_consensus(split, self.weight, self.nonlinear_point, self.dual, options.share),
            options.norm,
            self.integers if frozen else None,
        )
        lifted = mixed_integer(block)
        if lifted is None:
            return None
        var1 = split.invert(lifted)
        chosen = instance.assignment(var1)
        weight = _compute_weights(split, options, var1) if self.weight is None else self.weight
        rounded = np.where(instance.integer, np.round(var1), 0.0)
        time_mixed_integer = time.monotonic()
        var2 = _solve_nonlinear(
            split, var1, chosen, Consensus(weight, var1 + self.dual, 0.0), deadline
        )
        time_nonlinear = time.monotonic()
        residual = np.abs(var1 - var2) / split.span
        previous = var1 if self.nonlinear_point is None else self.nonlinear_point
        violation, objective = instance.violation(var2, chosen), instance.objective(var2)
        step = AdmmStep(
            mean_residual=float(residual.mean()),
            max_residual=float(residual.max()),
            dual_residual=float((np.abs(var2 - previous) / split.span).max()),
            violation=violation,
            objective=objective,
            mixed_integer_seconds=time_mixed_integer - time_begin,
            nonlinear_seconds=time_nonlinear - time_mixed_integer,
            new_integers=self.integers is None or not np.array_equal(rounded, self.integers),
        )
        self.integers, self.nonlinear_point = rounded, var2
        # Scaled duals shrink as the weights grow, so that their product, the multiplier, stays.
        self.dual = (self.dual + var1 - var2) / options.growth
        self.weight = weight * options.growth
        return _AdmmIterate(var2, chosen, violation, objective, number), step


def _compute_weights(split: SplitInstance, options: AdmmOptions, x: Array) -> Array:
    """Return the weights of the variables; integers have none in the nonlinear block."""
    weight = options.weight
    if weight is None:
        cost = abs(split.instance.objective(x))
        weight = options.penalty * max(cost, MIN_OBJECTIVE_SCALE) / split.span**2
    # Integers are fixed in the nonlinear block
    return np.where(split.instance.integer, 0.0, weight)


def _build_consensus(
    split: SplitInstance,
    weight: Array | None,
    nonlinear_point: Array | None,
    dual: Array,
    cost_weight: float,
) -> Consensus:
    """Build the consensus term of the mixed-integer block."""
    if weight is None or nonlinear_point is None:
        return Consensus(np.zeros(split.instance.size), np.zeros(split.instance.size), 1.0)
    return Consensus(weight, nonlinear_point - dual, cost_weight)


def _solve_nonlinear(
    split: SplitInstance, var1: Array, chosen: IntArray, consensus: Consensus, deadline: float
) -> Array:
    """Return the nearest point to var1 + dual at which the products hold."""
    numbers = split.form.build_parameters(split.instance, consensus)
    bounds = split.compute_nonlinear_bounds(var1, chosen)
    return solve_nlp(split.form, numbers, bounds, var1, deadline, ITERATIONS).v


def _polish_best(
    instance: Instance,
    best: _AdmmIterate | None,
    steps: list[AdmmStep],
    tolerance: float,
    deadline: float | None,
) -> tuple[Array | None, list[str]]:
    """Polish the best iterate at its integers, unless `deadline` is None.

    Returns:
        The polished point, the iterate where that violates constraints, or None without any
        iterate; and the log.
    """
    log = [f"{len(steps)} iterations"]
    if steps:
        log.append(
            f"last residual mean {steps[-1].mean_residual:.2g} max {steps[-1].max_residual:.2g}"
        )
    if best is None:
        return None, log
    log.append(f"best iterate {best.number + 1} violates by {best.violation:.2g}")
    if deadline is None:
        return best.x, log
    point = solve_fixed_integers(instance, best.x, best.assignment, deadline)
    log.append(f"polish: {point.word}, {point.iterations} iterations")
    is_feasible = instance.violation(point.v, best.assignment) <= tolerance
    return point.v if is_feasible else best.x, log


_BLOCK_GAP = 1e-3  # the next consensus moves the block anyway


def solve_admm_default(
    instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
) -> SolverResult:
    """Find a feasible point by ADMM with default options; `solve_admm` takes options.

    The status is "feasible" or "limit".

    Raises:
        UsageError: Big-M lacks a bound.
    """
    from climbplan.solvers.admm import AdmmOptions, solve_admm
    from climbplan.solvers.highs.instances import solve_highs

    begin = time.perf_counter()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        time_left = max(time_limit - (time.perf_counter() - begin), 0.1)
        result = solve_highs(disjoined.instance, _BLOCK_GAP, time_left)
        return None if result.x is None else disjoined.invert(result.x)

    options = AdmmOptions(freeze_after=2)
    return solve_admm(
        instance, mixed_integer, options=options, gap=gap, time_limit=time_limit
    ).result
