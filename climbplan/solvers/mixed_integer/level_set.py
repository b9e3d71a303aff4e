"""Bounds for variables without bounds, from the level set of an incumbent.

Branch and bound needs bounds of integers, and of directions in which the cost is flat. Every point
that is as good as an incumbent of cost v lies in {x: cost(x) <= v} within the continuous
relaxation. The extremes of a variable over this set are convex programs, and restrict no optimum.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Balls, Instance
from climbplan.progress import hide_searches
from climbplan.solvers.convex.clarabel import ClarabelSession
from climbplan.solvers.mixed_integer.conic_relaxation import ConicRelaxation
from climbplan.solvers.mixed_integer.conic_tree import ConicTree
from climbplan.solvers.separable_cost import factor_cost

_NODES = (20, 200, 4000)  # of the tree that looks for an incumbent, until there is one
_SLACK = 1e-6  # relative: by which level sets and extremes are widened against rounding
_MARGIN = 1.0  # by which bounds of continuous variables are widened: the tree needs an interior
_LARGEST = 1e6  # bounds beyond are not taken: the relaxation of such a box proves nothing


class UnboundedRelaxation(UsageError):
    """Report that the continuous relaxation has no solution, and is not infeasible."""


def relax_integers(instance: Instance) -> Instance:
    """Return the instance with continuous variables only."""
    return replace(instance, integer=np.zeros(instance.size, bool))


def bound_variables(
    instance: Instance, *, integers_only: bool, time_limit: float = np.inf
) -> Instance | None:
    """Return the instance with bounds of its variables; None if no point is feasible.

    Args:
        instance: Convex instance with integers, without choices and products.
        integers_only: Whether only integers get bounds, and all of them need some. Otherwise
            variables without bounds in the level set keep their open sides, integers only where
            the cost of some point is known.
        time_limit: Time limit [s] of the search for an incumbent.

    Raises:
        UnboundedRelaxation: The relaxation has no solution.
        UsageError: An integer that needs bounds has none in the level set.
    """
    box = propagate_box(instance)
    if (box.lower > box.upper).any():
        return None
    is_open = ~(np.isfinite(box.lower) & np.isfinite(box.upper))
    selected = is_open & instance.integer if integers_only else is_open
    if not selected.any():
        return instance
    relaxed = relax_integers(instance)
    relaxation = ClarabelSession().solve(relaxed)
    if relaxation.infeasible:
        return None
    if relaxation.x is None:
        raise UnboundedRelaxation(
            f"{instance.name}: its relaxation has no solution ({relaxation.log[-1]})"
        )
    cost, is_final = _find_cost(instance, time_limit)
    level = _build_level_set(relaxed, cost)
    lower, upper = instance.lower.copy(), instance.upper.copy()
    for j in map(int, np.flatnonzero(selected)):
        low, high = (_find_extreme(level, j, sign) for sign in (1.0, -1.0))
        # A search over integers without bounds would not end where there is no point
        needs_bounds = instance.integer[j] and (integers_only or (cost == np.inf and not is_final))
        if needs_bounds and not (np.isfinite(low) and np.isfinite(high)):
            raise UsageError(
                f"{level.name}: variable {j} has no bound where the cost is low: give it bounds"
            )
        margin = 0.0 if instance.integer[j] else _MARGIN
        lower[j], upper[j] = max(lower[j], low - margin), min(upper[j], high + margin)
    return replace(instance, lower=lower, upper=upper)


def _find_cost(instance: Instance, time_limit: float) -> tuple[float, bool]:
    """Return the cost of a good point, infinite where none is found, and whether none is better."""
    tree, deadline = ConicTree(instance), time.perf_counter() + time_limit
    for max_nodes in _NODES:
        with hide_searches():
            tree.run(deadline, max_nodes)
        if tree.incumbent is not None or tree.is_finished:
            break
    return tree.cost, tree.is_finished


def _build_level_set(instance: Instance, cost: float) -> Instance:
    """Return the instance with cost(x) <= cost, as a row or a second-order cone, and no cost.

    An infinite cost restricts nothing.

    With the cost 1/2 |u|^2 + s'x + c and t = cost - c - s'x it is |(u, t - 1/2)| <= t + 1/2.
    """
    squares = factor_cost(instance)
    top = cost + _SLACK * max(1.0, abs(cost)) - squares.constant
    slope = sparse.csr_matrix(squares.slope)
    without_cost = replace(instance, P=sparse.csc_matrix(instance.P.shape), constant=0.0)
    if cost == np.inf:
        return without_cost
    if not len(squares.offset):
        return replace(
            without_cost,
            A=sparse.vstack([instance.A, slope]).tocsr(),
            row_lower=np.append(instance.row_lower, -np.inf),
            row_upper=np.append(instance.row_upper, top),
            Q=sparse.csr_matrix((instance.A.shape[0] + 1, 0)),
        )
    cone = Balls(
        F=sparse.vstack([squares.U, -slope]).tocsr(),
        f=np.append(squares.offset, top - 0.5)[None],
        radius=np.array([top + 0.5]),
        slope=-slope,
    )
    return replace(without_cost, balls=(*instance.balls, cone))


def _find_extreme(level: Instance, j: int, sign: float) -> float:
    """Return the least value of a variable over the level set, or the largest for sign -1.

    It is infinite where there is none.
    """
    direction = np.zeros(level.size)
    direction[j] = sign
    relaxation = ConicRelaxation(replace(level, q=direction))
    solution = relaxation.solve(level.lower, level.upper)
    if solution.status != "solved" or abs(solution.x[j]) > _LARGEST:
        return -sign * np.inf
    # The dual value bounds the extreme; the primal one may stop short of it
    value = sign * solution.x[j]
    if np.isfinite(solution.bound):
        value = min(solution.bound, value)
    return float(sign * (value - _SLACK * max(1.0, abs(value))))
