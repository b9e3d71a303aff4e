"""Incumbents of a node: integers guessed from its relaxation, and points that leave none open."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import SOLVED
from climbplan.solvers.mixed_integer.bounds import (
    _apply,
    _bound,
    _objective,
    _solve_cut,
    _take_over,
)
from climbplan.solvers.mixed_integer.compiling import compiled, constant
from climbplan.solvers.mixed_integer.nodes import (
    BEST,
    FEASIBILITY,
    GUESSES,
    INCUMBENTS,
    Search,
    _slack_cutoff,
)
from climbplan.solvers.mixed_integer.numbers import Numbers
from climbplan.solvers.mixed_integer.spatial import _cell_of
from climbplan.solvers.mixed_integer.tangents import _outside
from climbplan.solvers.mixed_integer.working_set import _copy_working

_CLOSE_ROUNDS = constant(60)  # of tangents at points that may be incumbents


@compiled
def _guess(n: Numbers, s: Search, low: IntArray, high: IntArray, into: IntArray) -> None:
    """Every undecided integer at its nearest value; of a group the largest is 1."""
    E = len(n.column)
    for e in range(E):
        if low[e] == high[e]:
            into[e] = low[e]
            continue
        r = n.column[e]
        if n.spatial.cell[e] > 0.0:
            value = n.norm[r] * s.main.value[r] + s.offset[r]
            into[e] = _cell_of(n.spatial, e, value, low[e], high[e])
        elif r >= 0:
            value = n.norm[r] * s.main.value[r] + s.offset[r]
            into[e] = min(max(np.int64(np.round(value)), low[e]), high[e])
        else:
            into[e] = 1 if s.distance[1, e] <= s.distance[0, e] else 0
    for e in range(E):
        if n.group[e] < 0:
            continue
        best, chosen = -np.inf, -1
        begins = True
        for f in range(E):
            if n.group[f] != n.group[e]:
                continue
            if f < e:
                begins = False
                break
            value = n.norm[n.column[f]] * s.main.value[n.column[f]] + s.offset[n.column[f]]
            if low[f] == high[f]:
                value = 2.0 * low[f] - 1.0
            if value > best:
                best, chosen = value, f
        if begins:
            for f in range(e, E):
                if n.group[f] == n.group[e] and low[f] < high[f]:
                    into[f] = 1 if f == chosen else 0


@compiled
def _keep(s: Search, chosen: IntArray, objective: float) -> None:
    """The point at hand is the incumbent from now on."""
    s.real[BEST] = objective
    for j in range(len(s.w)):
        s.best_w[j] = s.w[j]
    for e in range(len(chosen)):
        s.best_whole[e] = chosen[e]
    s.whole[INCUMBENTS] += 1


@compiled
def _try(n: Numbers, s: Search, chosen: IntArray, limit: int) -> bool:
    """Solve with all integers given; True if that is a better incumbent."""
    _copy_working(s.main, s.probe)
    _apply(n, s, chosen, chosen)
    _take_over(n, s, s.probe)
    s.whole[GUESSES] += 1
    close = s.real[FEASIBILITY]
    found = _solve_cut(n, s, s.probe, _slack_cutoff(s), limit, _CLOSE_ROUNDS, close)
    if found != SOLVED:
        return False
    _bound(n, s, s.probe)
    if _outside(n, s) > 1.5 * close:
        return False
    objective = _objective(n, s.w)
    if objective >= s.real[BEST]:
        return False
    _keep(s, chosen, objective)
    return True


@compiled
def _leaf(n: Numbers, s: Search, chosen: IntArray) -> bool:
    """The solution of a node that leaves no integer open, which is the best in it.

    True if columns were rounded, so that the point has to be solved for again.
    """
    rounded = False
    for e in range(len(n.column)):
        chosen[e] = _decided_value(n, s, e)
        undecided = s.low[e] < s.high[e] and n.spatial.cell[e] == 0.0
        rounded = rounded or (undecided and n.column[e] >= 0)
    objective = _objective(n, s.w)
    if objective >= s.real[BEST]:
        return False
    if not rounded:
        _keep(s, chosen, objective)
    return rounded


@compiled
def _decided_value(n: Numbers, s: Search, e: int) -> Any:
    """The value that an integer has, or may have, at a point that leaves none open."""
    if s.low[e] == s.high[e]:
        return s.low[e]
    r = n.column[e]
    if n.spatial.cell[e] > 0.0:
        value = n.norm[r] * s.main.value[r] + s.offset[r]
        return _cell_of(n.spatial, e, value, s.low[e], s.high[e])
    if r >= 0:
        return np.int64(np.round(n.norm[r] * s.main.value[r] + s.offset[r]))
    return 1 if s.distance[1, e] == 0.0 else 0
