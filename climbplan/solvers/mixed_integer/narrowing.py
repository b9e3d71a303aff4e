"""Branch and bound whose nodes are narrowed by rows and products before they are relaxed.

Each node's box is what the checker of certificates leaves of it, its bound what the checker makes
of its relaxation's multipliers, so that the whole tree is a certificate. A node takes some
milliseconds, a hundred times those of the compiled tree; but where ranges follow from each other,
as those of normals and corners of books do, it needs very much fewer of them.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import Box, narrowed
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.rows import StatedRows, with_planes
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.leaf_multipliers import leaf_multipliers
from climbplan.solvers.mixed_integer.leaf_proofs import LeafProofs, Proved, Written
from climbplan.solvers.result import LEAST_OBJECTIVE

_INTEGRAL = 1e-6
_THIN = 1e-8  # relative width from which a factor's range is not split
_MIDDLE, _ENDS = 0.25, 0.15  # weight of the middle of a range, share that a split leaves at an end
_OFTEN, _EVERY = 16, 16  # nodes that are all looked at for incumbents, and each how many after
_SAFE = 0.1  # share of the gap by which leaves prove more than they must

Look = Callable[[Array, IntArray], float]
"""Cost of the best point known after a local search from x (n,) with alternatives (C,)."""


@dataclass
class _Node:
    """Before it is looked at, with what its parent proves of it."""

    box: Box | None
    proved: Proved
    split: int = -1
    at: float = 0.0
    below: int = -1
    above: int = -1


class NarrowingSearch:
    """Best-first, to a proof within the gap or a limit."""

    def __init__(self, instance: Instance, gap: float, best: float, look: Look) -> None:
        """best: cost of the best point known. Raises UsageError where nothing bounds a factor."""
        self._instance, self._gap, self._best, self._look = instance, gap, best, look
        self._proofs = LeafProofs(instance)
        self._rows, root = self._proofs.checker.rows, self._proofs.checker.root
        start = Proved(-np.inf, self._proofs.nothing(root))
        self._nodes = [_Node(root, start)]
        self._heap: list[tuple[float, int]] = [(-np.inf, 0)]
        self._width = np.maximum(root.upper - root.lower, 1e-300)
        weight = abs(self._rows.G[:, self._rows.w]).max(axis=0)
        self._weight = np.asarray(weight.todense()).ravel()
        self.count = 0  # nodes looked at
        self.closed = np.inf  # least bound of what was closed

    @property
    def bound(self) -> float:
        """A lower bound on the optimum."""
        return min(self.closed, self._heap[0][0] if self._heap else np.inf, self._best)

    @property
    def finished(self) -> bool:
        """Whether nothing is left open."""
        return not self._heap

    def run(self, deadline: float, most: int) -> None:
        """Until the gap is proved, or a limit of nodes or of `time.perf_counter` [s]."""
        while self._heap and self.count < most and time.perf_counter() < deadline:
            _, k = heapq.heappop(self._heap)
            self._visit(self._nodes[k])

    @property
    def _enough(self) -> float:
        if np.isinf(self._best):
            return np.inf
        gap = (1.0 - _SAFE) * self._gap
        return self._best - gap * max(abs(self._best), LEAST_OBJECTIVE)

    def _visit(self, node: _Node) -> None:
        """Close a node, or split it."""
        assert node.box is not None
        self.count += 1
        box, node.box = narrowed(self._rows, node.box), None
        if box.empty:
            node.proved = node.proved._replace(bound=np.inf)
            return
        if node.proved.bound < self._enough and self._split(node, box):
            return
        self.closed = min(self.closed, node.proved.bound)

    def _split(self, node: _Node, box: Box) -> bool:
        """Whether a node was split, after its relaxation and a local search from there."""
        rows = with_planes(self._rows, box.lower, box.upper)
        relaxed = leaf_multipliers(self._instance, rows, box, empty=False)
        tried = [self._proofs.nothing(box) if relaxed is None else relaxed.multipliers]
        if tried[0].point is None and self._proofs.tried(rows, box, tried[0]).bound < np.inf:
            # Said to be empty, by multipliers that do not prove it
            surely = leaf_multipliers(self._instance, rows, box, empty=True)
            tried += [] if surely is None else [surely.multipliers]
        for found in tried:
            proved = self._proofs.tried(rows, box, found)
            node.proved = proved if proved.bound > node.proved.bound else node.proved
        if node.proved.bound >= self._enough:
            return False
        if relaxed is None:
            return self._divide(node, box, 0.5 * (box.lower + box.upper))
        if self.count <= _OFTEN or self.count % _EVERY == 0:
            self._best = min(self._best, self._look(*self._point(relaxed.v)))
        return node.proved.bound < self._enough and self._divide(node, box, relaxed.v)

    def _point(self, v: Array) -> tuple[Array, IntArray]:
        """x and the likeliest alternative of each choice."""
        chosen, z = [], self._instance.size
        for choice in self._instance.choices:
            chosen.append(int(np.argmax(v[z : z + len(choice.alternatives)])))
            z += len(choice.alternatives)
        return v[: self._instance.size], np.array(chosen, np.int64)

    def _divide(self, node: _Node, box: Box, v: Array) -> bool:
        """Split at the integer or the factor that matters most; False if nothing is wide enough."""
        j, at = _place(self._rows, box, v, self._weight, self._width)
        if j < 0:
            return False
        node.split, node.at = j, at
        node.below, node.above = len(self._nodes), len(self._nodes) + 1
        for side in box.halves(self._rows, j, at):
            heapq.heappush(self._heap, (node.proved.bound, len(self._nodes)))
            self._nodes.append(_Node(side, node.proved))
        return True

    def certificate(self) -> Certificate:
        """All that is proved; nodes that are open have what their parents prove."""
        out, waiting = Written(), [0]
        while waiting:
            node = self._nodes[waiting.pop()]
            if node.split < 0:
                out.add_leaf(node.proved)
            else:
                out.add_split(node.split, node.at)
                waiting += [node.above, node.below]
        return out.certificate(self._instance)


def _place(rows: StatedRows, box: Box, v: Array, weight: Array, whole: Array) -> tuple[int, float]:
    """Variable and number of a split: an open integer first, then a factor; -1 for nothing.

    weight: (K,) by how much a row may fail for each unit that a product is off. whole: (N,) width
    of the first box.
    """
    width = box.upper - box.lower
    integers = np.flatnonzero(rows.integer & (width > 0.0))
    if len(integers):
        off = np.abs(v[integers] - np.round(v[integers]))
        j = int(integers[np.argmax(np.where(off > _INTEGRAL, off, 0.0))])
        return j, float(np.clip(np.floor(v[j]), box.lower[j], box.upper[j] - 1.0))
    off = np.abs(v[rows.w] - v[rows.first] * v[rows.second]) * weight
    size = np.maximum(1.0, np.maximum(np.abs(box.lower), np.abs(box.upper)))
    thin = width <= _THIN * size
    off[thin[rows.first] & thin[rows.second]] = -1.0
    q = int(np.argmax(off)) if len(off) else -1
    if q < 0 or off[q] < 0.0:
        return -1, 0.0
    factors = np.array([rows.first[q], rows.second[q]])
    share = np.where(thin[factors], -1.0, width[factors] / whole[factors])
    j = int(factors[np.argmax(share)])
    at = _MIDDLE * 0.5 * (box.lower[j] + box.upper[j]) + (1.0 - _MIDDLE) * v[j]
    room = _ENDS * width[j]
    return j, float(np.clip(at, box.lower[j] + room, box.upper[j] - room))
