"""ADMM between a mixed-integer and a nonlinear block, Algorithm 3 of chapter 6.4.

The printed dual update compares a vector with itself; here it is w <- w + var1 - var2. Without
convexity nothing guarantees convergence, so the best iterate is kept as the exact check ranks it,
and the pinned program finishes it.
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
from climbplan.solvers.ipopt.instances import ITERATIONS, TOLERANCE, minimise, solve_pinned
from climbplan.solvers.result import LEAST_OBJECTIVE, Answer, SolverResult, judged

NAME = "admm"
# A mixed-integer block -> its variables, None if it found none. Products are gone; integers,
# implications and choices are as stated.
MixedIntegerSolver = Callable[[Instance], Array | None]


@dataclass(frozen=True)
class AdmmOptions:
    """How the iterations go."""

    penalty: float = 10.0  # of a whole span of disagreement, in units of the cost at the start
    growth: float = 1.3  # of the weights from one iteration to the next, rho
    iterations: int = 15
    residual: float = 1e-3  # largest disagreement at which to stop, share of the variables' spans
    norm: Norm = "l2"
    share: float = 1.0  # of the cost beside the consensus in the mixed-integer block
    freeze_after: int | None = None  # iterations after which the integers stay
    mixed_integer_gap: float = 1e-3  # relative, that the mixed-integer block is solved to
    stop_when_feasible: bool = False  # at the first iterate that passes the exact check
    weight: Array | None = (
        None  # (n,) of each variable's disagreement, penalty / span^2 if left out
    )


@dataclass(frozen=True)
class AdmmStep:
    """Record of one iteration; residuals are shares of the variables' spans."""

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
    """The answer and how it came about."""

    result: SolverResult
    steps: tuple[AdmmStep, ...]
    best: int | None  # iteration (from 0) whose iterate was finished


@dataclass(frozen=True)
class _Iterate:
    x: Array
    assignment: IntArray
    violation: float
    objective: float
    number: int

    def rank(self, tolerance: float) -> tuple[float, float]:
        """Smaller is better: feasible ones by cost, others by violation."""
        return (max(self.violation, tolerance), self.objective)


def solve_admm(
    instance: Instance,
    mixed_integer: MixedIntegerSolver,
    start: Array | None = None,
    relax: Relaxation | None = None,
    options: AdmmOptions | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    polish: bool = True,
) -> AdmmResult:
    """A feasible point of an instance by consensus of its two blocks.

    start: (n,) first point of the nonlinear block; without one the first mixed-integer block has
    no consensus term. relax: envelopes of products in the mixed-integer block. polish: solve the
    pinned program from the best iterate. The time limit [s] is looked at between iterations and
    in the nonlinear block. Status is "feasible" or "limit"; ADMM proves nothing.
    """
    options = options or AdmmOptions()
    begin = time.monotonic()
    deadline = begin + time_limit
    split = (AdmmSplit() if relax is None else AdmmSplit(relax)).apply(instance)
    weight = None if start is None else _weights(split, options, start)
    other, dual = start, np.zeros(instance.size)
    steps: list[AdmmStep] = []
    best: _Iterate | None = None
    integers: Array | None = None
    for number in range(options.iterations):
        if time.monotonic() > deadline:
            break
        first = time.monotonic()
        frozen = options.freeze_after is not None and number >= options.freeze_after
        block = split.mixed_integer(
            _pull(split, weight, other, dual, options.share),
            options.norm,
            integers if frozen else None,
        )
        lifted = mixed_integer(block)
        if lifted is None:
            break
        var1 = split.invert(lifted)
        chosen = instance.assignment(var1)
        weight = _weights(split, options, var1) if weight is None else weight
        kept = np.where(instance.integer, np.round(var1), 0.0)
        changed = integers is None or not np.array_equal(kept, integers)
        integers = kept
        second = time.monotonic()
        var2 = _nonlinear(split, var1, chosen, Consensus(weight, var1 + dual, 0.0), deadline)
        third = time.monotonic()

        gone = np.abs(var1 - var2) / split.span
        moved = np.abs(var2 - (var1 if other is None else other)) / split.span
        violation = instance.violation(var2, chosen)
        objective = instance.objective(var2)
        steps.append(
            AdmmStep(
                mean_residual=float(gone.mean()),
                max_residual=float(gone.max()),
                dual_residual=float(moved.max()),
                violation=violation,
                objective=objective,
                mixed_integer_seconds=second - first,
                nonlinear_seconds=third - second,
                new_integers=changed,
            )
        )
        iterate = _Iterate(var2, chosen, violation, objective, number)
        if best is None or iterate.rank(tolerance) < best.rank(tolerance):
            best = iterate
        if gone.max() <= options.residual:
            break
        if options.stop_when_feasible and violation <= tolerance:
            break
        # Scaled duals shrink as the weights grow, so that their product, the multiplier, stays.
        dual = (dual + var1 - var2) / options.growth
        weight = weight * options.growth
        other = var2
    return _finished(instance, best, steps, gap, tolerance, polish, begin, deadline)


def _weights(split: SplitInstance, options: AdmmOptions, x: Array) -> Array:
    weight = options.weight
    if weight is None:
        cost = abs(split.instance.objective(x))
        weight = options.penalty * max(cost, LEAST_OBJECTIVE) / split.span**2
    # The nonlinear block takes integers as given
    return np.where(split.instance.integer, 0.0, weight)


def _pull(
    split: SplitInstance, weight: Array | None, other: Array | None, dual: Array, share: float
) -> Consensus:
    if weight is None or other is None:
        return Consensus(np.zeros(split.instance.size), np.zeros(split.instance.size), 1.0)
    return Consensus(weight, other - dual, share)


def _nonlinear(
    split: SplitInstance, var1: Array, chosen: IntArray, consensus: Consensus, deadline: float
) -> Array:
    """The nearest point to var1 + dual at which the products hold."""
    numbers = split.form.numbers(split.instance, consensus)
    bounds = split.nonlinear_bounds(var1, chosen)
    return minimise(split.form, numbers, bounds, var1, deadline, ITERATIONS).v


def _finished(
    instance: Instance,
    best: _Iterate | None,
    steps: list[AdmmStep],
    gap: float,
    tolerance: float,
    polish: bool,
    begin: float,
    deadline: float,
) -> AdmmResult:
    log = [f"{len(steps)} iterations"]
    if steps:
        log.append(
            f"last residual mean {steps[-1].mean_residual:.2g} max {steps[-1].max_residual:.2g}"
        )
    x = None
    if best is not None:
        x = best.x
        log.append(f"best iterate {best.number + 1} violates by {best.violation:.2g}")
        if polish:
            point = solve_pinned(instance, best.x, best.assignment, deadline)
            log.append(f"polish: {point.word}, {point.iterations} iterations")
            better = instance.violation(point.v, best.assignment) <= tolerance
            x = point.v if better else x
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
    return AdmmResult(
        judged(instance, answer, gap, tolerance),
        tuple(steps),
        None if best is None else best.number,
    )


_BLOCK_GAP = 1e-3  # the next consensus moves the block anyway


def solve_admm_default(
    instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
) -> SolverResult:
    """A feasible point by ADMM without further choices; `solve_admm` takes them.

    Status is "feasible" or "limit". Raises UsageError where big-M lacks a bound.
    """
    from climbplan.solvers.admm import AdmmOptions, solve_admm
    from climbplan.solvers.highs.instances import solve_highs

    begin = time.perf_counter()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        left = max(time_limit - (time.perf_counter() - begin), 0.1)
        found = solve_highs(disjoined.instance, _BLOCK_GAP, left)
        return None if found.x is None else disjoined.invert(found.x)

    options = AdmmOptions(freeze_after=2)
    return solve_admm(
        instance, mixed_integer, options=options, gap=gap, time_limit=time_limit
    ).result
