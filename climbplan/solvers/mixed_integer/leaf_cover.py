"""Warm start of a tree for the next problem of the same statement at other parameters.

The leaves of a finished tree cover all integers, and their multipliers prove their bounds.
Multipliers of the right sign give a bound for any problem data. The next tree therefore begins with
these leaves and the bounds that their multipliers have at the new data, and the last integers are
tried first (Marcucci and Tedrake, arXiv 1912.01110).

Ranges of factors are stored as numbers and divided into the cells of the next problem. The planes
of their envelopes are written for these ranges, and the stored multipliers are applied to them.

For a receding horizon integers, rows and multipliers shift by some steps along the first axis of
their blocks. Leaves that contradict the integers applied in the past steps are dropped. The others
still cover all remaining integers, so the warm start is exact for any shift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.blocks import Blocks
from climbplan.program.instance import Products
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.nodes import NodeTree, SearchState
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram
from climbplan.solvers.mixed_integer.row_keys import KeySpace, find_positions
from climbplan.solvers.mixed_integer.search import rebuild_bounds

_LEAF_STATES = (slots.OPEN, slots.CLOSED, slots.EMPTY_NODE, slots.GIVEN_UP)


@dataclass(frozen=True)
class HorizonShift:
    """Index of each variable, row and indicator row in the next problem, -1 for none."""

    variable: IntArray  # (size,)
    row: IntArray  # (m,)
    condition: IntArray  # (c,)


@dataclass(frozen=True)
class LeafCover:
    """A cover of all integers and factors with multipliers of each leaf, and the best point."""

    low: Array  # (S, E + F) lower bounds of integers, then of factors, -inf for none
    high: Array  # (S, E + F) upper bounds
    key: IntArray  # (S, K) keys of active rows, padded with -1
    side: NDArray[np.int8]
    multiplier: Array
    best: Array | None  # (size,) in the variables of the indicator form
    entities: IntArray  # (E,) indices of integers among the variables
    factors: IntArray  # (F,)
    space: KeySpace

    @classmethod
    def from_tree(
        cls,
        program: MixedIntegerProgram,
        form: IndicatorForm,
        search: SearchState,
        tree: NodeTree,
        max_leaves: int,
        best: Array | None,
    ) -> LeafCover:
        """Collect the leaves of a tree that has run, or the nodes of its upper part.

        Args:
            program: Program of the tree.
            form: Its indicator form.
            search: State of the search.
            tree: The nodes.
            most: Largest number of leaves; beyond it, ancestors replace the deepest leaves.
            best: (size,) incumbent.
        """
        leaves = _select_cover(tree, int(search.counters[slots.NUM_NODES]), max_leaves)
        row_key = np.append(program.row_key, -1)
        row = np.minimum(tree.row[leaves], len(program.row_key))  # tangents are dropped
        is_padding = np.arange(tree.row.shape[1]) >= tree.active[leaves][:, None]
        data, E = program.data, len(program.entities)
        low, high = tree.low[leaves].astype(float), tree.high[leaves].astype(float)
        at_lower, at_upper = low <= data.root_low, high >= data.root_high
        left, cell = data.spatial.left[E:], data.spatial.cell_width[E:]
        low[:, E:], high[:, E:] = left + cell * low[:, E:], left + cell * (high[:, E:] + 1.0)
        # Presolve has restricted the root's range: leaves at its edge extend to infinity, so that
        # they cover the root of any other parameters.
        low[at_lower], high[at_upper] = -np.inf, np.inf
        return cls(
            low=low,
            high=high,
            key=np.where(is_padding, -1, row_key[row]),
            side=tree.side[leaves].copy(),
            multiplier=tree.multiplier[leaves].copy(),
            best=best,
            entities=program.entities,
            factors=program.factors,
            space=KeySpace(form.size, len(form.row_lower), len(form.indicator), program.products),
        )

    def root(self) -> LeafCover:
        """Return a cover that contains the best point, and otherwise no information."""
        free = np.full((1, self.low.shape[1]), np.inf)
        return replace(
            self,
            low=-free,
            high=free,
            key=np.full((1, self.key.shape[1]), -1),
            side=np.zeros((1, self.key.shape[1]), np.int8),
            multiplier=np.zeros((1, self.key.shape[1])),
        )

    def shift(self, shift: HorizonShift) -> LeafCover:
        """Return the cover of a shifted problem, without leaves that contradict past integers."""
        variables = np.concatenate([self.entities, self.factors])
        position = np.full(len(shift.variable), -1)
        position[variables] = np.arange(len(variables))
        target = shift.variable[variables]
        target = np.where(target >= 0, position[target], -1)
        is_past = target < 0
        keep: BoolArray = np.ones(len(self.low), bool)
        best = None
        if self.best is not None:
            applied = self.best[variables]
            applied_high = np.where(
                np.arange(len(variables)) < len(self.entities),
                applied,
                np.nextafter(applied, np.inf),
            )
            keep = ((self.low <= applied) & (applied_high <= self.high))[:, is_past].all(axis=1)
            best = self.best.copy()  # the new last step repeats the previous one
            remains = shift.variable >= 0
            best[shift.variable[remains]] = self.best[remains]
        low = np.full((int(keep.sum()), len(target)), -np.inf)
        high = np.full_like(low, np.inf)
        low[:, target[~is_past]], high[:, target[~is_past]] = (
            self.low[keep][:, ~is_past],
            self.high[keep][:, ~is_past],
        )
        key = self.key[keep]
        shifted_key = self.space.remap(key.ravel(), shift.variable, shift.row, shift.condition)
        key = np.where(key >= 0, shifted_key.reshape(key.shape), -1)
        return replace(
            self,
            low=low,
            high=high,
            key=key,
            side=self.side[keep],
            multiplier=self.multiplier[keep],
            best=best,
        )

    def start_tree(self, program: MixedIntegerProgram, search: SearchState, tree: NodeTree) -> bool:
        """Begin a tree with these leaves; return False if they do not fit its program."""
        n, E = program.data, len(program.entities)
        if not len(self.low) or self.low.shape[1] != len(n.root_low):
            return False
        left, cell = n.spatial.left[E:], n.spatial.cell_width[E:]
        low, high = self.low.copy(), self.high.copy()
        # Adjacent leaves share a bound, which rounds to the same cell
        low[:, E:] = np.round((low[:, E:] - left) / cell)
        high[:, E:] = np.round((high[:, E:] - left) / cell) - 1.0
        low, high = np.maximum(low, n.root_low), np.minimum(high, n.root_high)
        possible = np.flatnonzero((low <= high).all(axis=1))
        count, width = len(possible), min(self.key.shape[1], tree.row.shape[1])
        if not count:
            return False
        tree.low[:count], tree.high[:count] = low[possible], high[possible]
        row = find_positions(self.key[possible].ravel(), program.row_key).reshape(count, -1)
        multiplier, side = self.multiplier[possible], self.side[possible]
        is_present = row >= 0
        # Rows that still exist move to the front
        order = np.argsort(~is_present, axis=1, kind="stable")[:, :width]
        for source, target in ((row, tree.row), (side, tree.side), (multiplier, tree.multiplier)):
            target[:count, :width] = np.take_along_axis(source, order, axis=1)
        tree.active[:count] = np.minimum(is_present.sum(axis=1), width)
        search.counters[slots.NUM_NODES] = count
        if self.best is not None and not len(self.factors):
            integers = np.round(self.best[self.entities]).astype(np.int64)
            search.proposals[0] = np.clip(integers, n.root_low, n.root_high)
            search.counters[slots.NUM_PROPOSALS] = 1
        rebuild_bounds(n, search, tree)
        return True


def _select_cover(tree: NodeTree, count: int, max_nodes: int) -> IntArray:
    """Select nodes that cover all integers: leaves, or the ancestors of those that lie too deep.

    Nodes at a depth cover everything below them. So all leaves above it and all nodes at it
    suffice.
    """
    is_leaf = np.isin(tree.state[:count], _LEAF_STATES)
    if np.count_nonzero(is_leaf) <= max_nodes:
        return np.flatnonzero(is_leaf)
    depth = tree.depth[:count]
    levels = int(depth.max()) + 1
    above = np.cumsum(np.bincount(depth[is_leaf], minlength=levels))
    num_inner = np.bincount(depth[~is_leaf], minlength=levels)
    deepest = int(np.flatnonzero(above + num_inner <= max_nodes).max(initial=0))
    return np.flatnonzero((is_leaf & (depth <= deepest)) | (~is_leaf & (depth == deepest)))


def build_horizon_shift(
    blocks: Blocks, form: IndicatorForm, steps: int, products: Products | None = None
) -> HorizonShift:
    """Build the shift by some steps along the first axis of each block, towards the beginning.

    Args:
        blocks: Blocks of the statement; those no longer than the shift stay unchanged.
        form: The indicator form.
        steps: Number of steps.
        products: Products that the form has as variables after the stated ones, which shift with
            their factors.
    """
    variable, size = np.full(form.size, -1), 0
    for block in blocks.variables:
        _shift_block(variable, block.start, block.shape, steps)
        size += int(np.prod(block.shape, dtype=int))
    if products is not None:
        variable[size : size + products.count] = _shift_products(variable, products, size)
    choice = 0
    for group in blocks.choices:
        target = _shift_entries(group.shape, steps)
        for k in range(len(target)):
            if target[k] >= 0 and len(form.choice[choice + k]) == len(
                form.choice[choice + target[k]]
            ):
                variable[form.choice[choice + k]] = form.choice[choice + target[k]]
        choice += len(target)
    row = np.full(len(form.row_lower), -1)
    begin = 0
    for rows in blocks.rows:
        begin = _shift_block(row, begin, rows.shape, steps)
    condition = np.full(len(form.indicator), -1)
    begin = 0
    for implied in blocks.implications:
        begin = _shift_block(condition, begin, implied.shape, steps)
    return HorizonShift(variable, row, condition)


def _shift_products(variable: IntArray, products: Products, begin: int) -> IntArray:
    """Return (K,) the product of the shifted factors of each product, -1 for none."""
    pairs = zip(products.first, products.second, strict=True)
    product_of = {(int(i), int(j)): begin + q for q, (i, j) in enumerate(pairs)}
    target = np.sort(np.stack([variable[products.first], variable[products.second]]), axis=0)
    return np.array([product_of.get((int(i), int(j)), -1) for i, j in target.T], np.int64)


def _shift_block(targets: IntArray, begin: int, shape: tuple[int, ...], steps: int) -> int:
    """Fill the targets of one block; return the index after it."""
    target = _shift_entries(shape, steps)
    targets[begin : begin + len(target)] = np.where(target >= 0, begin + target, -1)
    return begin + len(target)


def _shift_entries(shape: tuple[int, ...], steps: int) -> IntArray:
    """Return the target of each entry of a block within it, -1 for out of it."""
    size = int(np.prod(shape, dtype=int))
    if not shape or shape[0] <= steps:
        return np.arange(size)
    stride = size // shape[0]
    target = np.arange(size) - steps * stride
    return np.where(target >= 0, target, -1)
