"""Repair a nearly feasible point to full accuracy, with its integers fixed.

Newton steps on the products: each solves the convex problem with products linearised about the
previous point, with the least change. It completes points of solvers that work to 1e-6 in a row, of
complementarity relaxations and of envelopes.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.fixed_integers import linearise_products
from climbplan.solvers.result import FEASIBILITY

_STEPS = 8


def repair_point(
    instance: Instance,
    x: Array,
    assignment: IntArray | None = None,
    steps: int = _STEPS,
    tolerance: float = FEASIBILITY,
) -> Array:
    """Return the feasible point nearest to x with the integers and alternatives of x.

    Without products it is the best point with them instead. The point itself, with integers
    rounded, is returned if no better one is found, so callers have to check it.

    Args:
        instance: The instance.
        x: (n,) nearly feasible point.
        assignment: (C,) alternative of each choice, the least violated if missing.
        steps: Largest number of Newton steps.
        tolerance: Violation at which the point counts as feasible.
    """
    chosen = instance.assignment(x) if assignment is None else assignment
    best = np.where(instance.integer, np.round(x), x)
    iterate = best
    bilinear = instance.products.count > 0
    for _ in range(steps if bilinear else 1):
        if bilinear and instance.violation(best, chosen) <= tolerance:
            break
        solution = solve_convex(
            linearise_products(instance, iterate, chosen, keep_cost=not bilinear), "clarabel"
        ).x
        if solution is None:
            break
        iterate = np.where(instance.integer, best, solution)
        if instance.violation(iterate, chosen) < max(tolerance, instance.violation(best, chosen)):
            best = iterate
    return best
