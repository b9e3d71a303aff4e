"""Bounds of bilinear factors from the relaxation itself, so that its envelopes shrink.

Each factor of a product is minimised and maximised over the convex relaxation (McCormick envelopes
on the bounds so far, choices left out) and over cost <= that of a known point: no better point is
cut off. Bounds make envelopes tighter, which makes bounds tighter: the passes go on while there is
time and progress.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.box import propagate_box
from climbplan.program.instance import Balls, Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.convex.sessions import create_session, solve_convex
from climbplan.solvers.separable_cost import factor_cost

_NARROW = 1e-4  # ranges below this are left alone
_SLACK = 1e-6  # beyond each bound, for what the convex solver leaves
_PROGRESS = 0.9  # a pass that leaves more than this share of the widths is the last
_PASSES = 4


@dataclass(frozen=True)
class Tightened:
    """Bounds (n,) that hold for every point of P at most as costly as the one known."""

    bounds: ElementwiseRange
    programs: int  # convex ones solved
    passes: int
    infeasible: bool  # the relaxation has no such point: the known one is optimal


def find_factors(instance: Instance) -> IntArray:
    """Variables that are in a product."""
    return np.unique(np.concatenate([instance.products.first, instance.products.second]))


def tighten_bounds(
    instance: Instance,
    within: ElementwiseRange,
    best: float | None,
    time_limit: float,
    passes: int = _PASSES,
) -> Tightened:
    """Tighten the bounds of all factors.

    within: bounds to start from. best: cost of a known point of the instance, None without one.
    """
    begin = time.perf_counter()
    whole = propagate_box(replace(instance, lower=within.lower, upper=within.upper))
    low = np.maximum(within.lower, whole.lower)
    high = np.minimum(within.upper, whole.upper)
    relaxed = _without_choices(instance)
    form = LocalForm.of(relaxed)
    solver = create_session("clarabel")
    every = find_factors(instance)
    programs, done = 0, 0
    for _ in range(passes):
        before = _width(low, high, every)
        base = _feasibility(form.at(ElementwiseRange(low, high)), instance, best)
        order = every[np.argsort(-(high - low)[every])]
        for j in order[(high - low)[order] > _NARROW]:
            for sign in (1.0, -1.0):
                if time.perf_counter() - begin > time_limit:
                    return Tightened(ElementwiseRange(low, high), programs, done, False)
                q = np.zeros(base.size)
                q[j] = sign
                result = solve_convex(replace(base, q=q), solver, tolerance=1e-6)
                programs += 1
                if result.status == "infeasible":
                    return Tightened(ElementwiseRange(low, high), programs, done, True)
                # The multipliers' bound, not the solver's point: nothing feasible is lost
                if np.isfinite(result.bound):
                    if sign > 0:
                        low[j] = max(low[j], result.bound - _SLACK)
                    else:
                        high[j] = min(high[j], -result.bound + _SLACK)
        done += 1
        high = np.maximum(low, high)
        if _width(low, high, every) > _PROGRESS * before:
            break
    return Tightened(ElementwiseRange(low, high), programs, done, False)


def _width(low: Array, high: Array, columns: IntArray) -> float:
    return float((high - low)[columns].sum())


def _without_choices(instance: Instance) -> Instance:
    """The relaxation that keeps only choices of one alternative, as rows."""
    A, lower, upper = [instance.A], [instance.row_lower], [instance.row_upper]
    for choice in instance.choices:
        if len(choice.alternatives) > 1:
            continue
        only = choice.alternatives[0]
        A.append(sparse.csr_matrix(np.vstack([only.A, only.C])) @ choice.E)
        equal = only.c - only.C @ choice.e
        lower += [np.full(len(only.b), -np.inf), equal]
        upper += [only.b - only.A @ choice.e, equal]
    rows = sparse.vstack(A).tocsr()
    extra = rows.shape[0] - instance.A.shape[0]
    Q = sparse.vstack([instance.Q, sparse.csr_matrix((extra, instance.products.count))]).tocsr()
    return replace(
        instance,
        A=rows,
        Q=Q,
        row_lower=np.concatenate(lower),
        row_upper=np.concatenate(upper),
        choices=(),
    )


def _feasibility(local: Instance, instance: Instance, best: float | None) -> Instance:
    """The relaxation without its cost, which is at most `best` as a ball where it is of squares."""
    n = local.size
    feasibility = replace(local, P=sparse.csc_matrix((n, n)), q=np.zeros(n), constant=0.0)
    cost = factor_cost(instance)
    if best is None or cost.slope.any():
        return feasibility
    left = best - cost.constant + _SLACK * max(abs(best), 1e-3)
    wide = sparse.csr_matrix(
        (cost.U.data, cost.U.indices, cost.U.indptr), shape=(cost.U.shape[0], n)
    )
    radius = np.array([np.sqrt(2.0 * max(left, 0.0))])
    return replace(feasibility, balls=(*local.balls, Balls(wide, cost.offset[None], radius)))
