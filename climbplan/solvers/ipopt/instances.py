"""IPOPT through CasADi with MUMPS: smooth nonlinear programs, integers pinned.

Its word is not believed: feasibility and objective of what it returns are computed from the
instance.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import lru_cache

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.nlp_form import Bounds, Manner, NlpForm, nlp_form
from climbplan.solvers.ipopt.program import IpoptProgram, NlpPoint
from climbplan.solvers.result import Answer, SolverResult, judged

NAME = "ipopt"
TOLERANCE = 1e-6  # largest violation of an incumbent, in the unit of the rows
ITERATIONS = 300  # infeasible programs would use up IPOPT's own 3000


@lru_cache(maxsize=32)
def _compiled(form: NlpForm, iterations: int) -> IpoptProgram:
    problem = {"x": form.v, "p": form.p, "f": form.f, "g": form.g}
    settings = {
        "max_iter": iterations,
        "tol": 1e-8,
        "constr_viol_tol": 1e-8,
        "mu_strategy": "adaptive",
    }
    return IpoptProgram("nlp", problem, settings)


def minimise(
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
    inside = np.clip(start, bounds.lower, bounds.upper)
    if time.monotonic() > deadline:
        return NlpPoint(inside, np.nan, np.zeros(0), 0, "the time was over before it began", False)
    point = _compiled(form, iterations).solve(inside, numbers, bounds, deadline)
    # IPOPT widens bounds by 1e-8; its point is brought back into them.
    return replace(point, v=np.clip(point.v, bounds.lower, bounds.upper))


def solve_pinned(
    instance: Instance,
    start: Array,
    assignment: IntArray | None = None,
    deadline: float = np.inf,
    iterations: int = ITERATIONS,
) -> NlpPoint:
    """The program that is left when the integers of `start` (n,) and the choices are kept.

    Implications that are active become rows, so nothing leaks. assignment: the alternative of each
    choice, the least violated at the start if left out.
    """
    form = nlp_form(instance, Manner("pinned"))
    bounds = form.pinned_bounds(instance, start, assignment)
    return minimise(form, form.numbers(instance), bounds, start, deadline, iterations)


def middle(instance: Instance) -> Array:
    """A start without knowledge: the middle of each variable's bounds, zero where there are none.

    With one bound only, the point of the bounded side that is nearest to zero.
    """
    both = np.isfinite(instance.lower) & np.isfinite(instance.upper)
    low, high = np.where(both, instance.lower, 0.0), np.where(both, instance.upper, 0.0)
    return np.clip((low + high) / 2, instance.lower, instance.upper)


def solve_ipopt(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
    assignment: IntArray | None = None,
) -> SolverResult:
    """A local optimum of an instance whose integers and choices are given by a start.

    start: (n,); its integers, rounded, are kept. gap: not used to stop, since a local method has
    no bound. Status is "feasible" or "limit", never "optimal" or "infeasible". Raises UsageError
    for integers or choices without a start.
    """
    if start is None and instance.features & {"integers", "choices"}:
        raise UsageError(f"{instance.name}: {NAME} needs a start whose integers it keeps")
    begin = time.monotonic()
    first = middle(instance) if start is None else start
    point = solve_pinned(instance, first, assignment, begin + time_limit)
    return judged(
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
