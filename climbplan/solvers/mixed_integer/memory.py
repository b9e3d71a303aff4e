"""What a tree leaves for the next problem of the same statement at other parameters.

The leaves of a finished tree cover all integers, and their multipliers prove their bounds.
Multipliers of the right sign give a bound whatever the numbers are, so the next tree begins with
these leaves and the bounds that their multipliers have now, instead of with one root that knows
nothing; the last integers are tried first (Marcucci and Tedrake, arXiv 1912.01110).

Boxes of factors are kept as numbers and divided into the cells of the next problem, whose ranges
are others; the planes of their envelopes are written anew there, and the multipliers meet these.

For a receding horizon everything moves by some steps along the first axis of its block: integers,
rows, multipliers. Leaves that disagree with what was done in the steps that are over are dropped;
the others still cover all integers that are left, so nothing is lost whatever was moved where.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.blocks import Blocks
from climbplan.program.instance import Products
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.keys import KeySpace, places
from climbplan.solvers.mixed_integer.nodes import Search, Tree
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram
from climbplan.solvers.mixed_integer.search import revive

_LEFT = (place.OPEN, place.CLOSED, place.EMPTY_NODE, place.LEFT)


@dataclass(frozen=True)
class Move:
    """Where variables, integers and rows of one problem stand in the next one, -1 for nowhere."""

    variable: IntArray  # (size,)
    row: IntArray  # (m,)
    condition: IntArray  # (c,)


@dataclass(frozen=True)
class Leaves:
    """A cover of all integers and factors with the multipliers of each part, and the best point."""

    low: Array  # (S, E + F) integers, then factors: least values, -inf where they are free
    high: Array  # and largest ones
    key: IntArray  # (S, K) of active rows, -1 behind the last
    side: NDArray[np.int8]
    multiplier: Array
    best: Array | None  # (size,) in the variables of the conditional form
    entities: IntArray  # (E,) places among the variables
    factors: IntArray  # (F,)
    space: KeySpace

    @classmethod
    def of(
        cls,
        program: MixedIntegerProgram,
        form: Conditional,
        search: Search,
        tree: Tree,
        most: int,
        best: Array | None,
    ) -> Leaves:
        """Of a tree that has run; where they are more than `most`, of its upper part."""
        here = _cover(tree, int(search.whole[place.COUNT]), most)
        stated = np.append(program.key, -1)
        row = np.minimum(tree.row[here], len(program.key))  # tangents are forgotten
        behind = np.arange(tree.row.shape[1]) >= tree.active[here][:, None]
        n, E = program.numbers, len(program.entities)
        low, high = tree.low[here].astype(float), tree.high[here].astype(float)
        first, last = low <= n.lowest, high >= n.highest
        left, cell = n.spatial.left[E:], n.spatial.cell[E:]
        low[:, E:], high[:, E:] = left + cell * low[:, E:], left + cell * (high[:, E:] + 1.0)
        # The root had what was left by its parameters: leaves at its edge reach beyond it, so that
        # they cover whatever others leave.
        low[first], high[last] = -np.inf, np.inf
        return cls(
            low=low,
            high=high,
            key=np.where(behind, -1, stated[row]),
            side=tree.side[here].copy(),
            multiplier=tree.multiplier[here].copy(),
            best=best,
            entities=program.entities,
            factors=program.factors,
            space=KeySpace(form.size, len(form.row_lower), len(form.when), program.products),
        )

    def root(self) -> Leaves:
        """A cover that knows no more than its best point."""
        free = np.full((1, self.low.shape[1]), np.inf)
        return replace(
            self,
            low=-free,
            high=free,
            key=np.full((1, self.key.shape[1]), -1),
            side=np.zeros((1, self.key.shape[1]), np.int8),
            multiplier=np.zeros((1, self.key.shape[1])),
        )

    def moved(self, move: Move) -> Leaves:
        """The same cover for a problem in which everything has moved; those that are over go."""
        at = np.concatenate([self.entities, self.factors])
        number = np.full(len(move.variable), -1)
        number[at] = np.arange(len(at))
        to = move.variable[at]
        to = np.where(to >= 0, number[to], -1)
        over = to < 0
        keep: BoolArray = np.ones(len(self.low), bool)
        best = None
        if self.best is not None:
            done = self.best[at]
            below = np.where(
                np.arange(len(at)) < len(self.entities), done, np.nextafter(done, np.inf)
            )
            keep = ((self.low <= done) & (below <= self.high))[:, over].all(axis=1)
            best = self.best.copy()  # what is new repeats what was last
            there = move.variable >= 0
            best[move.variable[there]] = self.best[there]
        low = np.full((int(keep.sum()), len(to)), -np.inf)
        high = np.full_like(low, np.inf)
        low[:, to[~over]], high[:, to[~over]] = self.low[keep][:, ~over], self.high[keep][:, ~over]
        key = self.key[keep]
        moved = self.space.moved(key.ravel(), move.variable, move.row, move.condition)
        key = np.where(key >= 0, moved.reshape(key.shape), -1)
        return replace(
            self,
            low=low,
            high=high,
            key=key,
            side=self.side[keep],
            multiplier=self.multiplier[keep],
            best=best,
        )

    def into(self, program: MixedIntegerProgram, search: Search, tree: Tree) -> bool:
        """Begin a tree, which must have room, with these leaves; False if they do not fit it."""
        n, E = program.numbers, len(program.entities)
        if not len(self.low) or self.low.shape[1] != len(n.lowest):
            return False
        left, cell = n.spatial.left[E:], n.spatial.cell[E:]
        low, high = self.low.copy(), self.high.copy()
        # Two leaves have the same number where they meet, and so the same cell
        low[:, E:] = np.round((low[:, E:] - left) / cell)
        high[:, E:] = np.round((high[:, E:] - left) / cell) - 1.0
        low, high = np.maximum(low, n.lowest), np.minimum(high, n.highest)
        possible = np.flatnonzero((low <= high).all(axis=1))
        count, width = len(possible), min(self.key.shape[1], tree.row.shape[1])
        if not count:
            return False
        tree.low[:count], tree.high[:count] = low[possible], high[possible]
        row = places(self.key[possible].ravel(), program.key).reshape(count, -1)
        multiplier, side = self.multiplier[possible], self.side[possible]
        known = row >= 0
        # Rows that are still there move to the front
        order = np.argsort(~known, axis=1, kind="stable")[:, :width]
        for source, target in ((row, tree.row), (side, tree.side), (multiplier, tree.multiplier)):
            target[:count, :width] = np.take_along_axis(source, order, axis=1)
        tree.active[:count] = np.minimum(known.sum(axis=1), width)
        search.whole[place.COUNT] = count
        if self.best is not None and not len(self.factors):
            integers = np.round(self.best[self.entities]).astype(np.int64)
            search.hint[0] = np.clip(integers, n.lowest, n.highest)
            search.whole[place.HINTED] = 1
        revive(n, search, tree)
        return True


def _cover(tree: Tree, count: int, most: int) -> IntArray:
    """Nodes that cover all integers: the leaves, or the parents of those that lie too deep.

    Nodes of a depth cover what lies below them, so that leaves above it and all nodes at it do.
    """
    left = np.isin(tree.state[:count], _LEFT)
    if np.count_nonzero(left) <= most:
        return np.flatnonzero(left)
    depth = tree.depth[:count]
    levels = int(depth.max()) + 1
    above = np.cumsum(np.bincount(depth[left], minlength=levels))
    at = np.bincount(depth[~left], minlength=levels)
    deepest = int(np.flatnonzero(above + at <= most).max(initial=0))
    return np.flatnonzero((left & (depth <= deepest)) | (~left & (depth == deepest)))


def shifted(
    blocks: Blocks, form: Conditional, steps: int, products: Products | None = None
) -> Move:
    """Everything by some steps along the first axis of its block, towards the beginning.

    Blocks whose first axis is no longer than the steps stay where they are. products: those that
    the form has as variables behind the stated ones; each moves with its factors.
    """
    variable, size = np.full(form.size, -1), 0
    for block in blocks.variables:
        _placed(variable, block.start, block.shape, steps)
        size += int(np.prod(block.shape, dtype=int))
    if products is not None:
        variable[size : size + products.count] = _with_factors(variable, products, size)
    at = 0
    for group in blocks.choices:
        to = _along(group.shape, steps)
        for k in range(len(to)):
            if to[k] >= 0 and len(form.choice[at + k]) == len(form.choice[at + to[k]]):
                variable[form.choice[at + k]] = form.choice[at + to[k]]
        at += len(to)
    row = np.full(len(form.row_lower), -1)
    begin = 0
    for rows in blocks.rows:
        begin = _placed(row, begin, rows.shape, steps)
    condition = np.full(len(form.when), -1)
    begin = 0
    for implied in blocks.implications:
        begin = _placed(condition, begin, implied.shape, steps)
    return Move(variable, row, condition)


def _with_factors(variable: IntArray, products: Products, begin: int) -> IntArray:
    """(K,) where each product is that of the factors which take its place, -1 for nowhere."""
    pairs = zip(products.first, products.second, strict=True)
    number = {(int(i), int(j)): begin + q for q, (i, j) in enumerate(pairs)}
    to = np.sort(np.stack([variable[products.first], variable[products.second]]), axis=0)
    return np.array([number.get((int(i), int(j)), -1) for i, j in to.T], np.int64)


def _placed(into: IntArray, begin: int, shape: tuple[int, ...], steps: int) -> int:
    to = _along(shape, steps)
    into[begin : begin + len(to)] = np.where(to >= 0, begin + to, -1)
    return begin + len(to)


def _along(shape: tuple[int, ...], steps: int) -> IntArray:
    """Where each entry of a block moves to within it, -1 for out of it."""
    size = int(np.prod(shape, dtype=int))
    if not shape or shape[0] <= steps:
        return np.arange(size)
    stride = size // shape[0]
    to = np.arange(size) - steps * stride
    return np.where(to >= 0, to, -1)
