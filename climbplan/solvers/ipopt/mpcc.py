"""Solve complementarity constraints by IPOPT: a homotopy in eps, then fixed integers.

The homotopy follows chapter 7.2.1 with eps falling step by step, each from the last point (Scholtes
2001). The polish rounds the integers and solves the rest with active implications as plain rows, so
the answer does not depend on eps.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.complementarity import Complementarity, RoundedPoint
from climbplan.solvers.ipopt.instances import (
    ITERATIONS,
    TOLERANCE,
    compute_box_center,
    solve_fixed_integers,
    solve_nlp,
)
from climbplan.solvers.result import Answer, SolverResult, judge_answer

NAME = "mpcc"
# A wide start leaves binaries free, so that the cost determines them. From a point with good
# integers the single step is as good and faster.
HOMOTOPY = (1.0, 0.3, 1e-1, 1e-2, 1e-3, 1e-4)
STRAIGHT = (1e-3,)  # the published relaxation


@dataclass(frozen=True)
class HomotopyStep:
    """IPOPT's result at one eps."""

    eps: float
    iterations: int
    word: str  # IPOPT's return status
    fraction: float  # largest distance of a binary from 0 or 1
    seconds: float


@dataclass(frozen=True)
class RelaxedPoint:
    """The end of a homotopy, before polish."""

    v: Array  # (N,) in the variables of the nonlinear program
    rounded: RoundedPoint
    violation: float  # of the instance at the rounded point, caused by eps
    steps: tuple[HomotopyStep, ...]


def follow_homotopy(
    instance: Instance,
    method: Complementarity,
    start: Array,
    assignment: IntArray | None = None,
    homotopy: tuple[float, ...] = HOMOTOPY,
    blur: float = 0.0,
    *,
    deadline: float = np.inf,
    iterations: int = ITERATIONS,
) -> RelaxedPoint:
    """Follow eps from a start (n,) of the statement.

    Args:
        instance: The instance.
        method: Complementarity reformulation.
        start: (n,) start.
        assignment: (C,) alternative of each choice at the start.
        homotopy: Values of eps, in order.
        blur: Fraction by which the start's binaries are moved towards 1/2.
        deadline: Time of `time.monotonic` [s].
        iterations: Largest number of iterations of each step.

    Raises:
        UsageError: Big-M lacks a bound.
        ValueError: The homotopy is empty.
    """
    if not homotopy:
        raise ValueError("a homotopy has at least one eps")
    smooth = method.apply(instance)
    v = smooth.build_start(start, assignment, blur)
    steps: list[HomotopyStep] = []
    for eps in homotopy:
        begin = time.monotonic()
        if steps and begin > deadline:
            break
        point = solve_nlp(
            smooth.form, smooth.numbers, smooth.compute_bounds(eps), v, deadline, iterations
        )
        v = point.v
        fraction = smooth.round_point(v).fraction
        duration = time.monotonic() - begin
        steps.append(HomotopyStep(eps, point.iterations, point.word, fraction, duration))
    rounded = smooth.round_point(v)
    violation = instance.violation(rounded.x, rounded.assignment)
    return RelaxedPoint(v, rounded, violation, tuple(steps))


def solve_mpcc(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    *,
    start: Array | None = None,
    assignment: IntArray | None = None,
    method: Complementarity | None = None,
    homotopy: tuple[float, ...] = HOMOTOPY,
    blur: float | None = None,
    polish: bool = True,
    iterations: int = ITERATIONS,
) -> SolverResult:
    """Find a local optimum of an instance; the exact check decides its feasibility.

    The status is "feasible" or "limit": a local method proves nothing.

    Args:
        instance: The instance.
        gap: Not used to stop.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        start: (n,) start, the center of the bounds if missing.
        assignment: (C,) alternative of each choice at the start.
        method: Complementarity reformulation.
        homotopy: Values of eps, in order.
        blur: Fraction by which the start's binaries are moved towards 1/2; by default 0 with a
            start and 1 without.
        polish: Whether to solve the program at the rounded integers.
        iterations: Largest number of iterations of each program.
    """
    begin = time.monotonic()
    deadline = begin + time_limit
    method = method or Complementarity()
    blur = (1.0 if start is None else 0.0) if blur is None else blur
    x = compute_box_center(instance) if start is None else start
    relaxed = follow_homotopy(
        instance, method, x, assignment, homotopy, blur, deadline=deadline, iterations=iterations
    )
    x, chosen = relaxed.rounded.x, relaxed.rounded.assignment
    count = sum(step.iterations for step in relaxed.steps)
    log = [f"eps {s.eps:g}: {s.word}, {s.iterations} iterations" for s in relaxed.steps]
    log.append(f"rounded from {relaxed.rounded.fraction:.2g}, off by {relaxed.violation:.2g}")
    if polish:
        point = solve_fixed_integers(instance, x, chosen, deadline, iterations)
        count += point.iterations
        log.append(f"polish: {point.word}, {point.iterations} iterations")
        x = point.v
    answer = Answer(
        x=x,
        bound=-np.inf,
        infeasible=False,
        nodes=count,
        time=time.monotonic() - begin,
        solver=f"{NAME} ({method.kind}, {method.coupling})",
        log=tuple(log),
        assignment=chosen,
    )
    return judge_answer(instance, answer, gap, tolerance)
