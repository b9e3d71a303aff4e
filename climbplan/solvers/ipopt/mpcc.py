"""Complementarity constraints by IPOPT: a homotopy in eps, then the pinned program.

The homotopy follows chapter 7.2.1 with eps falling step by step, each from the last point. The
polish rounds the integers and solves what is left with active implications as plain rows: no eps
leaks into the answer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.complementarity import Complementarity, Rounded
from climbplan.solvers.ipopt.instances import ITERATIONS, TOLERANCE, middle, minimise, solve_pinned
from climbplan.solvers.result import Answer, SolverResult, judged

NAME = "mpcc"
# Wide first: binaries are free, so that the cost chooses. From a point with good integers the
# straight one does as well in a third of the time.
HOMOTOPY = (1.0, 0.3, 1e-1, 1e-2, 1e-3, 1e-4)
STRAIGHT = (1e-3,)  # the published relaxation


@dataclass(frozen=True)
class HomotopyStep:
    """What IPOPT did at one eps."""

    eps: float
    iterations: int
    word: str  # IPOPT's return status
    fraction: float  # largest distance of a binary from 0 or 1
    seconds: float


@dataclass(frozen=True)
class RelaxedPoint:
    """The end of a homotopy, before polish."""

    v: Array  # (N,) as the nonlinear program has it
    rounded: Rounded
    violation: float  # of the instance at the rounded point: what leaked through eps
    steps: tuple[HomotopyStep, ...]


def follow(
    instance: Instance,
    method: Complementarity,
    start: Array,
    assignment: IntArray | None = None,
    homotopy: tuple[float, ...] = HOMOTOPY,
    blur: float = 0.0,
    deadline: float = np.inf,
    iterations: int = ITERATIONS,
) -> RelaxedPoint:
    """Follow eps from a start (n,) of the statement; deadline in `time.monotonic` seconds.

    blur: how far the start's binaries are drawn towards 1/2, from 0 to 1. Raises UsageError where
    big-M lacks a bound, ValueError for an empty homotopy.
    """
    if not homotopy:
        raise ValueError("a homotopy has at least one eps")
    smooth = method.apply(instance)
    v = smooth.start(start, assignment, blur)
    steps: list[HomotopyStep] = []
    for eps in homotopy:
        begin = time.monotonic()
        if steps and begin > deadline:
            break
        point = minimise(smooth.form, smooth.numbers, smooth.bounds(eps), v, deadline, iterations)
        v = point.v
        fraction = smooth.rounded(v).fraction
        spent = time.monotonic() - begin
        steps.append(HomotopyStep(eps, point.iterations, point.word, fraction, spent))
    rounded = smooth.rounded(v)
    leak = instance.violation(rounded.x, rounded.assignment)
    return RelaxedPoint(v, rounded, leak, tuple(steps))


def solve_mpcc(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
    assignment: IntArray | None = None,
    method: Complementarity | None = None,
    homotopy: tuple[float, ...] = HOMOTOPY,
    blur: float | None = None,
    polish: bool = True,
    iterations: int = ITERATIONS,
) -> SolverResult:
    """A local optimum of an instance with integers, judged by the exact check.

    start: (n,), the middle of the bounds if left out. assignment: alternatives of the choices at
    the start. blur: how far the start's binaries are drawn towards 1/2: by default not at all for
    a given start, fully for none. polish: solve the pinned program at the rounded integers.
    Status is "feasible" or "limit": a local method proves nothing.
    """
    begin = time.monotonic()
    deadline = begin + time_limit
    method = method or Complementarity()
    blur = (1.0 if start is None else 0.0) if blur is None else blur
    first = middle(instance) if start is None else start
    relaxed = follow(instance, method, first, assignment, homotopy, blur, deadline, iterations)
    x, chosen = relaxed.rounded.x, relaxed.rounded.assignment
    count = sum(step.iterations for step in relaxed.steps)
    log = [f"eps {s.eps:g}: {s.word}, {s.iterations} iterations" for s in relaxed.steps]
    log.append(f"rounded from {relaxed.rounded.fraction:.2g}, off by {relaxed.violation:.2g}")
    if polish:
        point = solve_pinned(instance, x, chosen, deadline, iterations)
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
    return judged(instance, answer, gap, tolerance)
