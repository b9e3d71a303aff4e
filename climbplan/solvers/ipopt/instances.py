"""IPOPT through CasADi with MUMPS: smooth nonlinear programs with fixed integers.

Feasibility and objective of its point are computed from the instance, not taken from IPOPT.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import lru_cache

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.nlp_form import Bounds, NlpForm, NlpOptions, build_nlp_form
from climbplan.solvers.ipopt.program import IpoptProgram, NlpPoint
from climbplan.solvers.result import Answer, SolverResult, judge_answer

NAME = "ipopt"
TOLERANCE = 1e-6  # largest violation of an incumbent, in the unit of the rows
ITERATIONS = 300  # IPOPT's default of 3000 would be spent on infeasible programs


@lru_cache(maxsize=32)
def _compile_program(form: NlpForm, iterations: int) -> IpoptProgram:
    """Compile the program of a form, once for each form."""
    problem = {"x": form.v, "p": form.p, "f": form.f, "g": form.g}
    settings = {
        "max_iter": iterations,
        "tol": 1e-8,
        "constr_viol_tol": 1e-8,
        "mu_strategy": "adaptive",
    }
    return IpoptProgram("nlp", problem, settings)


def solve_nlp(
    form: NlpForm,
    numbers: Array,
    bounds: Bounds,
    start: Array,
    deadline: float = np.inf,
    iterations: int = ITERATIONS,
) -> NlpPoint:
    """Run IPOPT on a form from a start (N,); deadline in `time.monotonic` seconds.

    After the deadline the start itself is returned, without building the program's derivatives.
    """
    clipped_start = np.clip(start, bounds.lower, bounds.upper)
    if time.monotonic() > deadline:
        return NlpPoint(
            clipped_start, np.nan, np.zeros(0), 0, "the time was over before it began", False
        )
    point = _compile_program(form, iterations).solve(clipped_start, numbers, bounds, deadline)
    # IPOPT widens bounds by 1e-8; its point is brought back into them.
    return replace(point, v=np.clip(point.v, bounds.lower, bounds.upper))


def solve_fixed_integers(
    instance: Instance,
    start: Array,
    assignment: IntArray | None = None,
    deadline: float = np.inf,
    iterations: int = ITERATIONS,
) -> NlpPoint:
    """Solve the program with the integers of `start` (n,) and the choices fixed.

    Active implications become rows, so the result does not depend on a relaxation.

    Args:
        instance: The instance.
        start: (n,) start.
        assignment: (C,) alternative of each choice, the least violated at the start if missing.
        deadline: Time of `time.monotonic` [s].
        iterations: Largest number of iterations.
    """
    form = build_nlp_form(instance, NlpOptions("pinned"))
    bounds = form.compute_fixed_bounds(instance, start, assignment)
    return solve_nlp(form, form.build_parameters(instance), bounds, start, deadline, iterations)


def compute_box_center(instance: Instance) -> Array:
    """Return a start without prior knowledge: the center of each variable's bounds.

    It is zero without bounds, and with one bound the feasible value nearest to zero.
    """
    is_bounded = np.isfinite(instance.lower) & np.isfinite(instance.upper)
    low, high = np.where(is_bounded, instance.lower, 0.0), np.where(is_bounded, instance.upper, 0.0)
    return np.clip((low + high) / 2, instance.lower, instance.upper)


def solve_ipopt(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
    assignment: IntArray | None = None,
) -> SolverResult:
    """Find a local optimum of an instance with integers and choices fixed by a start.

    The status is "feasible" or "limit", never "optimal" or "infeasible".

    Args:
        instance: The instance.
        gap: Not used to stop, since a local method has no bound.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        start: (n,) start, whose rounded integers are fixed.
        assignment: (C,) alternative of each choice.

    Raises:
        UsageError: Integers or choices without a start.
    """
    if start is None and instance.features & {"integers", "choices"}:
        raise UsageError(f"{instance.name}: {NAME} needs a start whose integers it keeps")
    begin = time.monotonic()
    first = compute_box_center(instance) if start is None else start
    point = solve_fixed_integers(instance, first, assignment, begin + time_limit)
    return judge_answer(
        instance,
        Answer(
            x=point.v,
            bound=-np.inf,
            infeasible=False,
            nodes=point.iterations,
            time=time.monotonic() - begin,
            solver=NAME,
            log=(f"IPOPT: {point.word}, {point.iterations} iterations",),
            assignment=assignment,
        ),
        gap,
        tolerance,
    )
