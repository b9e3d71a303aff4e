"""Which integer a node is split at.

By pseudo-costs, which a few dual steps in both children begin (reliability branching: Achterberg,
Koch and Martin 2005). A child that these few steps close is a leaf at once.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import EMPTY, _solve
from climbplan.solvers.mixed_integer.bounds import (
    _apply,
    _bound,
    _far,
    _follow_ray,
    _proved_empty,
    _reach,
    _take_over,
)
from climbplan.solvers.mixed_integer.compiling import compiled, constant
from climbplan.solvers.mixed_integer.nodes import (
    BEST,
    BRANCHED,
    FEASIBILITY,
    HEAP,
    MOST,
    PROBES,
    WORK,
    Search,
    Tree,
    _child,
    _close,
    _cutoff,
    _push,
    _slack_cutoff,
    _store,
)
from climbplan.solvers.mixed_integer.numbers import Numbers
from climbplan.solvers.mixed_integer.spatial import _wanted_split
from climbplan.solvers.mixed_integer.working_set import Working, _copy_working

_PROBE_ITERATIONS = constant(25)
_RELIABLE = 4  # branchings after which an integer's pseudo-costs are believed
_PROBED = 8  # integers probed at a node
_INTEGRAL = 1e-6  # of columns
_SPACE = 0.1  # share of the average that a split in space is worth, whatever the first ones were
_STAY = 0.5  # share of the way from the least open bound to the cutoff at which a dive goes on


@compiled
def _measure(n: Numbers, s: Search, w: Working, low: IntArray, high: IntArray) -> int:
    """How far each undecided entity is from being decided down and up; how many are open."""
    open_count = 0
    slack = s.real[FEASIBILITY]
    for e in range(len(n.column)):
        s.distance[0, e] = s.distance[1, e] = 0.0
        if low[e] == high[e] or n.spatial.cell[e] > 0.0:
            continue
        r = n.column[e]
        if r >= 0:
            value = n.norm[r] * w.value[r] + s.offset[r]
            down = value - np.floor(value)
            up = 1.0 - down
            if min(down, up) <= _INTEGRAL:
                down = up = 0.0
            s.distance[0, e], s.distance[1, e] = down, up
        else:
            for place in range(n.first[e], n.first[e + 1]):
                r = n.rows_of[place]
                over = w.value[r] - s.base_upper[r]
                under = s.base_lower[r] - w.value[r]
                worst = max(over, under) * n.norm[r]
                if worst > slack:
                    here = n.value[r]
                    s.distance[here, e] = max(s.distance[here, e], worst * n.share[r])
        if s.distance[0, e] > 0.0 and s.distance[1, e] > 0.0:
            open_count += 1
    if open_count == 0 and len(n.spatial.first) > 0:  # integers first, as they decide rows
        open_count = _measure_products(n, s, w, low, high)
    return open_count


@compiled
def _value_of(n: Numbers, s: Search, w: Working, e: int, low: IntArray, high: IntArray) -> float:
    """The value of an integer with a column, or of a factor, at a relaxation's solution."""
    if low[e] == high[e] and n.spatial.cell[e] == 0.0:
        return float(low[e])
    r = n.column[e]
    return n.norm[r] * w.value[r] + s.offset[r]


@compiled
def _is_held(n: Numbers, s: Search, w: Working, q: int, low: IntArray, high: IntArray) -> bool:
    """Whether a row that holds a product has to hold, or would if no integer were split."""
    p = n.spatial
    if p.always[q]:
        return True
    for place in range(p.since[q], p.since[q + 1]):
        e = p.entity[place]
        if low[e] == high[e]:
            value = low[e]
        elif n.column[e] >= 0:
            value = np.int64(np.round(_value_of(n, s, w, e, low, high)))
        else:
            value = 1 if s.distance[1, e] == 0.0 else 0
        if value == p.value[place]:
            return True
    return False


@compiled
def _measure_products(n: Numbers, s: Search, w: Working, low: IntArray, high: IntArray) -> int:
    """Factors of products that are off where it matters are open, too; how many products are."""
    p, open_count = n.spatial, 0
    for q in range(len(p.first)):
        if not _is_held(n, s, w, q, low, high):
            continue
        i, j, r = p.first[q], p.second[q], p.place[q]
        x, y = _value_of(n, s, w, i, low, high), _value_of(n, s, w, j, low, high)
        off = abs(n.norm[r] * w.value[r] + s.offset[r] - x * y)
        if off * p.weight[q] <= s.real[FEASIBILITY]:
            continue
        found = False
        for turn in range(2):
            e = i if turn == 0 else j
            if low[e] < high[e]:
                share = min(off / p.area[q], 1.0)
                if p.cell[e] > 0.0:  # what is wide still promises most
                    share *= (high[e] - low[e] + 1.0) / (n.highest[e] - n.lowest[e] + 1.0)
                s.distance[0, e] = max(s.distance[0, e], share)
                s.distance[1, e] = max(s.distance[1, e], share)
                found = True
        open_count += 1 if found else 0
    return open_count


@compiled
def _split(n: Numbers, s: Search, e: int) -> int:
    """The largest value of the lower child."""
    r = n.column[e]
    if r < 0:
        return 0
    if n.spatial.cell[e] > 0.0:
        at = n.norm[r] * s.main.value[r] + s.offset[r]
        return _wanted_split(n.spatial, e, at, s.low[e], s.high[e])
    value = np.int64(np.floor(n.norm[r] * s.main.value[r] + s.offset[r]))
    return min(max(value, s.low[e]), s.high[e] - 1)


@compiled
def _probe_child(n: Numbers, s: Search, e: int, up: int, split: int) -> float:
    """The bound of a child after a few dual steps."""
    low, high = s.low[e], s.high[e]
    if up:
        s.low[e] = split + 1
    else:
        s.high[e] = split
    _copy_working(s.main, s.probe)
    _apply(n, s, s.low, s.high)
    _take_over(n, s, s.probe)
    s.whole[PROBES] += 1
    found = _solve(s.rows, s.probe, _slack_cutoff(s), _PROBE_ITERATIONS)
    bound, _ = _bound(n, s, s.probe)
    if found == EMPTY:
        bound = max(bound, _proved_empty(s, s.probe) - _reach(n, s))
        if bound >= _cutoff(s):
            _follow_ray(s, s.probe, _far(s))
        if bound > n.ceiling:
            bound = np.inf
    s.low[e], s.high[e] = low, high
    return bound


@compiled
def _score(down: float, up: float) -> float:
    return max(down, 1e-9) * max(up, 1e-9)


@compiled
def _expected(n: Numbers, s: Search, e: int, way: int, average: float) -> float:
    """Gain of a child by pseudo-costs."""
    rate = s.gain[way, e] / s.seen[way, e] if s.seen[way, e] > 0 else average
    if n.spatial.cell[e] > 0.0:
        rate = max(rate, _SPACE * average)
    return rate * s.distance[way, e]


@compiled
def _probe_way(
    n: Numbers, s: Search, tree: Tree, node: int, e: int, way: int, split: int
) -> tuple[float, bool]:
    """The bound of a child by a probe, and whether that closed the child; teaches pseudo-costs."""
    parent = tree.bound[node]
    reached = max(parent, _probe_child(n, s, e, way, split))
    gain = reached - parent
    if not np.isinf(gain):
        s.gain[way, e] += gain / s.distance[way, e]
        s.seen[way, e] += 1
    if reached < _cutoff(s):
        return reached, False
    # The child is closed, and keeps the multipliers that do it
    new = _child(n, s, tree, node, e, way, split, reached)
    _store(tree, new, s.probe)
    _close(s, tree, new, reached)
    return reached, True


@compiled
def _most_promising(s: Search) -> int:
    """The integer of largest score."""
    best = 0
    for e in range(1, len(s.score)):
        if s.score[e] > s.score[best]:
            best = e
    return best


@compiled
def _branch(n: Numbers, s: Search, tree: Tree, node: int) -> int:
    """Split a node; the child to go on with, -1 for none."""
    E = len(n.column)
    parent = tree.bound[node]
    total, times = 0.0, 0
    for way in range(2):
        for e in range(E):
            if s.seen[way, e] > 0:
                total += s.gain[way, e] / s.seen[way, e]
                times += 1
    average = total / times if times > 0 else 1.0
    # By what pseudo-costs promise: of those that are known well the best, the first few others are
    # probed.
    best, chosen = -1.0, 0
    for e in range(E):
        s.score[e] = -1.0
        if s.distance[0, e] > 0.0 and s.distance[1, e] > 0.0:
            down, up = _expected(n, s, e, 0, average), _expected(n, s, e, 1, average)
            score = _score(down, up)
            if min(s.seen[0, e], s.seen[1, e]) < _RELIABLE:
                s.score[e] = score
            elif score > best:
                best, chosen = score, e
    below, above = parent, parent  # bounds of the children
    made_below, made_above = False, False  # children that their probes have closed
    probed = _PROBED
    if np.isinf(s.real[BEST]) and s.whole[WORK] < MOST:
        # Steps are counted, and without an incumbent nothing is closed: dive
        probed = 0
        e = _most_promising(s)
        if s.score[e] > best:
            chosen = e
    for _ in range(probed):
        e = _most_promising(s)
        if s.score[e] < 0.0:
            break
        s.score[e] = -1.0
        split = _split(n, s, e)
        down, up = parent, parent
        for way in range(2):
            reached, closed = _probe_way(n, s, tree, node, e, way, split)
            if way == 0:
                down, made_below = reached, closed
            else:
                up, made_above = reached, closed
        closed = made_below or made_above
        here = np.inf if closed else _score(down - parent, up - parent)
        if here > best:
            best, chosen = here, e
            below, above = down, up
        if closed:
            break
    split = _split(n, s, chosen)
    tree.state[node] = BRANCHED
    prefer = 0 if s.distance[0, chosen] < s.distance[1, chosen] else 1
    if below != above:
        prefer = 0 if below < above else 1
    follow = -1
    for turn in range(2):
        way = prefer if turn == 0 else 1 - prefer
        if made_above if way else made_below:
            continue
        new = _child(n, s, tree, node, chosen, way, split, above if way else below)
        _store(tree, new, s.main)
        if follow < 0:
            follow = new
        else:
            _push(tree, s.whole, new)
    if follow >= 0 and not np.isinf(s.real[BEST]) and s.whole[HEAP] > 0:
        cutoff, least = _cutoff(s), tree.bound[tree.heap[0]]
        if tree.bound[follow] > least + _STAY * max(cutoff - least, 0.0):
            _push(tree, s.whole, follow)
            follow = -1
    return follow
