"""Relaxations of nodes and the bounds that they prove.

Every bound is the dual value of multipliers of the right sign, less what the proximal term can be
worth within the box and what rounding can, so it holds whatever limits did to the solution. Balls
enter as tangents, which hold in the whole tree.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.active_set import EMPTY, SOLVED, STUCK, _solve
from climbplan.solvers.mixed_integer.compiling import compiled, constant
from climbplan.solvers.mixed_integer.nodes import (
    _LOSS,
    BEST,
    CONSTANT,
    GAP,
    Search,
    _cutoff,
    _slack_cutoff,
)
from climbplan.solvers.mixed_integer.numbers import ALWAYS, DECIDED, Numbers
from climbplan.solvers.mixed_integer.spatial import _end, _place_envelopes
from climbplan.solvers.mixed_integer.tangents import _cut_balls
from climbplan.solvers.mixed_integer.working_set import (
    Working,
    _drop_absent,
    _dual_value,
    _edge,
    _refactor,
)
from climbplan.solvers.result import LEAST_OBJECTIVE

_CENTERS = 4  # how often the proximal term is moved at a node
_CUT_ROUNDS = constant(6)  # of tangents to balls at a node that has integers open
_CUT_FROM = 1e-5  # violation of a ball from which such a node cuts
_ROUNDING = 1e-14  # what multipliers times rows and bounds are good to, relative


@compiled
def _apply(n: Numbers, s: Search, low: IntArray, high: IntArray) -> None:
    """Which rows a node has, and bounds of its entities."""
    rows = s.rows
    for r in range(rows.used[0]):
        kind = n.when[r]
        if kind == ALWAYS:
            continue
        e = n.entity[r]
        decided = low[e] == high[e]
        if kind == DECIDED:
            rows.on[r] = decided and low[e] == n.value[r]
        else:
            rows.on[r] = not decided
    for e in range(len(n.column)):
        r = n.column[e]
        if r >= 0:
            rows.lower[r] = (_end(n.spatial, e, low[e], 0) - s.offset[r]) / n.norm[r]
            rows.upper[r] = (_end(n.spatial, e, high[e], 1) - s.offset[r]) / n.norm[r]
    if len(n.spatial.first) > 0:
        _place_envelopes(
            n.spatial, low, high, rows.M, rows.T, rows.lower, rows.upper, rows.on, rows.tolerance,
            n.norm, s.offset, s.u,
        )  # fmt: skip


@compiled
def _take_over(n: Numbers, s: Search, w: Working) -> None:
    """A working set of another node for the one whose rows are in place."""
    _drop_absent(s.rows, w)
    if len(n.spatial.first) > 0:
        _refactor(s.rows, w)  # envelopes are other rows now


@compiled
def _bound(n: Numbers, s: Search, w: Working) -> tuple[float, float]:
    """The bound that multipliers prove, and what the proximal term cost it; leaves w in s.w."""
    value = _dual_value(s.rows, w) + s.real[CONSTANT]
    k = len(s.u)
    size, length = 0.0, 0.0
    for i in range(k):
        length += w.v[i] * w.v[i]
    length = np.sqrt(length)
    for i in range(w.count[0]):
        edge = _edge(s.rows, w.row[i], w.side[i])
        size += abs(w.multiplier[i]) * (length + (0.0 if np.isinf(edge) else abs(edge)))
    value -= _ROUNDING * size
    for i in range(k - 1, -1, -1):
        total = w.v[i] - s.u[i]
        line = n.U[i]
        for j in range(i + 1, k):
            total -= line[j] * s.w[j]
        s.w[i] = total / line[i]
    loss = 0.0
    for i in range(k):
        if n.eps[i] == 0.0:
            continue
        off = s.w[i] - s.center[i]
        pull = n.eps[i] * off
        end = n.box_upper[i] if pull > 0 else n.box_lower[i]
        loss += 0.5 * n.eps[i] * off * off + pull * (end - s.w[i])
    loss = max(loss, 0.0)
    return value - loss, loss


@compiled
def _objective(n: Numbers, w: Array) -> float:
    """The stated cost at w."""
    k = len(w)
    total = n.constant
    for i in range(k):
        if w[i] != 0.0:
            half = 0.0
            line = n.H[i]
            for j in range(k):
                half += line[j] * w[j]
            total += w[i] * (0.5 * half + n.g[i])
    return total


@compiled
def _solve_cut(
    n: Numbers, s: Search, w: Working, cutoff: float, limit: int, rounds: int, tolerated: float
) -> int:
    """Solve the node's rows and the tangents that its balls need."""
    found = SOLVED
    for turn in range(rounds + 1):
        found = _solve(s.rows, w, cutoff, limit)
        if len(n.radius) == 0 or found != SOLVED or turn == rounds:
            break
        _bound(n, s, w)
        if _cut_balls(n, s, tolerated) <= 0:
            break
    return found


@compiled
def _recenter(n: Numbers, s: Search) -> None:
    """Move the centre of the proximal term to s.w, clipped to the box."""
    k = len(s.u)
    step = s.spare[0]
    for i in range(k):
        new = min(max(s.w[i], n.box_lower[i]), n.box_upper[i])
        step[i] = n.eps[i] * (new - s.center[i])
        if n.eps[i] > 0.0:
            s.center[i] = new
    for i in range(k):
        total = step[i]
        for j in range(i):
            total -= n.L[i, j] * step[j]
        step[i] = total / n.L[i, i]
    constant = n.constant
    for i in range(k):
        s.u[i] -= step[i]
        constant += 0.5 * n.eps[i] * s.center[i] ** 2 - 0.5 * s.u[i] ** 2
    s.real[CONSTANT] = constant
    m = s.rows.used[0]
    shift = s.shift
    for r in range(m):
        shift[r] = 0.0
    for j in range(k):
        if step[j] != 0.0:
            column = s.rows.T[j]
            for r in range(m):
                shift[r] += step[j] * column[r]
    for r in range(m):
        s.base_lower[r] -= shift[r]
        s.base_upper[r] -= shift[r]
        s.offset[r] += n.norm[r] * shift[r]
        s.rows.lower[r] -= shift[r]
        s.rows.upper[r] -= shift[r]


@compiled
def _proved_empty(s: Search, w: Working) -> float:
    """The bound that a ray of an empty program proves, with the constant."""
    k = s.rows.M.shape[1]
    pull = s.spare[1]
    pull[:] = 0.0
    gain = 0.0
    for i in range(w.ray_count[0]):
        row, side, weight = w.ray_row[i], w.ray_side[i], w.ray[i]
        if weight < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
            weight = 0.0
        gain -= weight * _edge(s.rows, row, side)
        for j in range(k):
            pull[j] += weight * side * s.rows.M[row, j]
    if gain <= 0.0:
        return -np.inf
    square = 0.0
    for j in range(k):
        square += pull[j] * pull[j]
    return 0.5 * gain * gain / max(square, 1e-300) + s.real[CONSTANT]


@compiled
def _reach(n: Numbers, s: Search) -> float:
    """No proximal term within the box is worth more."""
    total = 0.0
    for i in range(len(n.eps)):
        if n.eps[i] > 0.0:
            width = n.box_upper[i] - n.box_lower[i]
            total += 0.5 * n.eps[i] * width * width
    return total


@compiled
def _far(s: Search) -> float:
    """A dual value that closes a node for certain: how far a ray is followed."""
    best = s.real[BEST]
    return 1.0 + abs(s.real[CONSTANT]) + (0.0 if np.isinf(best) else 2.0 * abs(best))


@compiled
def _follow_ray(s: Search, w: Working, enough: float) -> None:
    """Multipliers of an empty program so far along its ray that their dual value is enough."""
    value = _dual_value(s.rows, w)
    slope = 0.0
    for i in range(w.ray_count[0]):
        slope -= w.ray[i] * _edge(s.rows, w.ray_row[i], w.ray_side[i])
    step = max(enough - value, 0.0) / max(slope, 1e-300)
    count = w.count[0]
    for i in range(w.ray_count[0] - 1):
        w.multiplier[i] += step * w.ray[i]
    last = w.ray_count[0] - 1
    if count < len(w.row):
        w.row[count], w.side[count] = w.ray_row[last], w.ray_side[last]
        w.multiplier[count] = step
        w.active[w.row[count]] = 1
        w.count[0] = count + 1


@compiled
def _relax(n: Numbers, s: Search, limit: int) -> tuple[int, float]:
    """Solve the node at hand in s.main, and its bound: infinite if it is empty for certain."""
    low, high = s.low, s.high
    found, bound = SOLVED, -np.inf
    for turn in range(_CENTERS + 1):
        last = turn == _CENTERS
        cutoff = np.inf if last else _slack_cutoff(s)
        found = _solve_cut(n, s, s.main, cutoff, limit, _CUT_ROUNDS, _CUT_FROM)
        here, loss = _bound(n, s, s.main)
        bound = max(bound, here)
        if found == EMPTY:
            bound = max(bound, _proved_empty(s, s.main) - _reach(n, s))
            break
        allowed = _LOSS * s.real[GAP] * max(abs(bound), LEAST_OBJECTIVE)
        if found == STUCK or last or bound >= _cutoff(s) or (loss <= allowed and found == SOLVED):
            break
        _recenter(n, s)
        _apply(n, s, low, high)
    return found, np.inf if bound > n.ceiling else bound
