"""The tree, compiled: what is done at a node, and which comes next.

The search dives until it has an incumbent; afterwards it goes on with a child while that may still
be the best open node, else with the open node of least bound.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import CUT_OFF, EMPTY, SOLVED, STUCK
from climbplan.solvers.mixed_integer.bounds import (
    _apply,
    _bound,
    _far,
    _follow_ray,
    _relax,
    _take_over,
)
from climbplan.solvers.mixed_integer.branching import (
    _branch,
    _measure,
)
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.incumbents import _CLOSE_ROUNDS, _guess, _leaf, _try
from climbplan.solvers.mixed_integer.nodes import (
    AGAIN,
    BEST,
    BRANCHED,
    CONSTANT,
    COUNT,
    DONE,
    EMPTY_NODE,
    FEASIBILITY,
    GROW,
    GROW_ROWS,
    HEAP,
    HINTED,
    LEFT,
    LEFT_BOUND,
    NEXT,
    NODES,
    OPEN,
    PAUSE,
    SEEDED,
    UNPROVED,
    WORK,
    Search,
    Tree,
    _child,
    _close,
    _cutoff,
    _load,
    _pop,
    _push,
    _store,
)
from climbplan.solvers.mixed_integer.numbers import Numbers
from climbplan.solvers.mixed_integer.tangents import _cut_balls, _outside
from climbplan.solvers.mixed_integer.working_set import _FAR, _clear, _edge

_ITERATIONS = 400  # of one re-solve, and as many again for each column
_CUT_SHARE = 80  # room for tangents that a node must find, by ball
_EVERY = 8  # nodes between guesses once there is an incumbent


@compiled
def _split_anyhow(n: Numbers, s: Search, tree: Tree, node: int) -> None:
    """Neither solved nor proved empty: split what is undecided, or leave it with its bound."""
    chosen = -1
    for e in range(len(n.column)):
        if s.low[e] < s.high[e]:
            chosen = e
            break
    if chosen < 0:
        s.whole[UNPROVED] += 1
        tree.state[node] = LEFT
        s.real[LEFT_BOUND] = min(s.real[LEFT_BOUND], tree.bound[node])
        return
    split = (s.low[chosen] + s.high[chosen]) // 2
    for up in range(2):
        new = _child(n, s, tree, node, chosen, up, split, tree.bound[node])
        _store(tree, new, s.main)
        _push(tree, s.whole, new)
    tree.state[node] = BRANCHED


@compiled
def _process(n: Numbers, s: Search, tree: Tree, node: int, warm: bool) -> int:
    """One node; the child to go on with, -1 for none."""
    E = len(n.column)
    for e in range(E):
        s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
    _apply(n, s, s.low, s.high)
    if warm:
        _take_over(n, s, s.main)
    else:
        _load(s, tree, node)
    limit = _ITERATIONS + len(s.u)
    found, bound = STUCK, -np.inf
    for turn in range(2):
        found, here = _relax(n, s, limit if turn == 0 else 4 * limit)
        bound = max(bound, here)
        if found in (SOLVED, CUT_OFF) or bound >= _cutoff(s) or s.rows.stop[0]:
            break
        _clear(s.main)  # rounding got the better of the factors: once more from the beginning
    if s.rows.stop[0] and not bound >= _cutoff(s):
        # Told to stop half-way: open again, with what multipliers prove so far
        if bound > tree.bound[node]:
            tree.bound[node] = bound
            _store(tree, node, s.main)
        _push(tree, s.whole, node)
        return -1
    tree.bound[node] = max(tree.bound[node], bound)
    if found == EMPTY and bound >= _cutoff(s):
        # What closes the node is a ray: multipliers that follow it say so to whoever reads them
        _follow_ray(s, s.main, _far(s))
        _store(tree, node, s.main)
        _close(s, tree, node, bound)
        return -1
    _store(tree, node, s.main)
    if tree.bound[node] >= _cutoff(s):
        _close(s, tree, node, tree.bound[node])
        return -1
    if found != SOLVED:
        _split_anyhow(n, s, tree, node)
        return -1
    leaf = _measure(n, s, s.main, s.low, s.high) == 0
    if leaf and _outside(n, s) > s.real[FEASIBILITY]:
        # Balls are to be met before the point says anything
        if _cut_balls(n, s, s.real[FEASIBILITY]) > 0 and s.whole[AGAIN] < _CLOSE_ROUNDS:
            s.whole[AGAIN] += 1
            return node
        _split_anyhow(n, s, tree, node)
        return -1
    s.whole[AGAIN] = 0
    if len(n.spatial.first) > 0:
        return _process_products(n, s, tree, node, leaf)
    wanted = np.isinf(s.real[BEST]) or s.whole[NODES] % _EVERY == 1
    if leaf:
        wanted = _leaf(n, s, s.chosen)
    elif s.whole[HINTED]:
        for i in range(s.whole[HINTED]):
            for e in range(E):
                s.chosen[e] = s.hint[i, e]
            _try(n, s, s.chosen, limit)
        s.whole[HINTED] = 0
        wanted = False
        _apply(n, s, s.low, s.high)
    elif wanted:
        _guess(n, s, s.low, s.high, s.chosen)
    if wanted:
        _try(n, s, s.chosen, limit)
        _apply(n, s, s.low, s.high)
    if leaf or tree.bound[node] >= _cutoff(s):
        _close(s, tree, node, tree.bound[node])
        return -1
    return _branch(n, s, tree, node)


@compiled
def _process_products(n: Numbers, s: Search, tree: Tree, node: int, leaf: bool) -> int:
    """The rest of a node with products, which leaves the looking for incumbents to its caller."""
    if leaf and _leaf(n, s, s.chosen):
        _split_anyhow(n, s, tree, node)  # an integer that is whole, but not decided
        return -1
    if not leaf:
        _guess(n, s, s.low, s.high, s.seed_whole)
        for j in range(len(s.w)):
            s.seed[j] = s.w[j]
        s.whole[SEEDED] = 1
    if leaf or tree.bound[node] >= _cutoff(s):
        _close(s, tree, node, tree.bound[node])
        return -1
    return _branch(n, s, tree, node)


@compiled
def run(n: Numbers, s: Search, tree: Tree, nodes: int, most: int) -> int:
    """Process up to `nodes` nodes, `most` in all: DONE, GROW if the tree needs room, or PAUSE.

    DONE, too, after the dual steps of WORK, and once another thread sets `stop` of the rows.
    """
    whole = s.whole  # what is left open stays so
    room = len(tree.bound) - 4
    for _ in range(nodes):
        if s.rows.stop[0]:
            return DONE
        if whole[COUNT] >= room:
            return GROW
        if len(n.radius) > 0 and s.rows.used[0] + _CUT_SHARE * len(n.radius) >= len(n.when):
            return GROW_ROWS
        node, warm = whole[NEXT], True
        whole[NEXT] = -1
        if node < 0:
            warm = False
            if whole[HEAP] == 0:
                return DONE
            node = _pop(tree, whole)
        if tree.bound[node] >= _cutoff(s):
            _close(s, tree, node, tree.bound[node])
            continue
        if whole[NODES] >= most or s.main.iterations[0] + s.probe.iterations[0] >= whole[WORK]:
            _push(tree, whole, node)
            return DONE
        whole[NODES] += 1
        whole[NEXT] = _process(n, s, tree, node, warm)
    return PAUSE


@compiled
def settle(n: Numbers, s: Search, tree: Tree, node: int) -> None:
    """Solve a leaf again, for multipliers that prove its bound.

    Children that a probe closed too late, or that were never looked at, have their parent's.
    """
    for e in range(len(n.column)):
        s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
    _apply(n, s, s.low, s.high)
    _load(s, tree, node)
    found, bound = _relax(n, s, 4 * (_ITERATIONS + len(s.u)))
    if found == EMPTY:
        tree.state[node] = EMPTY_NODE
    if found != STUCK or bound > tree.bound[node]:  # multipliers prove it, whatever stopped them
        tree.bound[node] = bound
        _store(tree, node, s.main)


@compiled
def revive(n: Numbers, s: Search, tree: Tree) -> None:
    """Bounds of the nodes that a tree begins with, from multipliers found for other numbers."""
    w = s.main
    for node in range(s.whole[COUNT]):
        for e in range(len(n.column)):
            s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
        _apply(n, s, s.low, s.high)
        _clear(w)
        count = 0
        for i in range(tree.active[node]):
            row, side = tree.row[node, i], float(tree.side[node, i])
            multiplier = tree.multiplier[node, i]
            if s.rows.on[row] == 0 or abs(_edge(s.rows, row, side)) > _FAR:
                continue
            if multiplier < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
                continue
            w.row[count], w.side[count], w.multiplier[count] = row, side, multiplier
            count += 1
        w.count[0] = count
        bound, _ = _bound(n, s, w)
        if not bound > s.real[CONSTANT]:
            # Worth less than none, as far along a ray that no longer proves anything
            for i in range(tree.active[node]):
                tree.multiplier[node, i] = 0.0
            for i in range(count):
                w.multiplier[i] = 0.0
            bound, _ = _bound(n, s, w)
        tree.bound[node] = bound
        tree.state[node] = OPEN
        w.count[0] = 0
        _push(tree, s.whole, node)


@compiled
def rounded(n: Numbers, s: Search, low: IntArray, high: IntArray, into: IntArray) -> None:
    """Integers near the relaxation that was solved last, of a node with this range."""
    _measure(n, s, s.main, low, high)
    _guess(n, s, low, high, into)
