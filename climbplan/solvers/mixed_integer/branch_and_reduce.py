"""Branch and reduce: branch and bound with bound tightening at each node.

Bounds of each node are tightened through rows and products before its relaxation is solved (Ryoo
and Sahinidis 1996). The tightening is that of the certificate checker, and a node's bound is what
the checker computes from its multipliers, so the whole tree is a certificate. A node takes some
milliseconds, far more than in the compiled tree. But where ranges imply each other, as those of
normals and corners of books do, far fewer nodes are needed.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import CertificateBox, tighten_box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.rows import CertificateRows, append_envelopes
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.leaf_multipliers import compute_leaf_multipliers
from climbplan.solvers.mixed_integer.leaf_proofs import CertificateWriter, LeafProof, LeafProofs
from climbplan.solvers.result import compute_closing_bound, compute_zero_cost

_INTEGRAL = 1e-6
_THIN = 1e-8  # relative width below which a factor's range is not split
_MIDDLE, _ENDS = 0.25, 0.15  # weight of a range's midpoint, least fraction on either side
_OFTEN, _EVERY = 16, 16  # local search at each of the first nodes, later at each so many
_SAFE = 0.1  # fraction of the gap that leaves keep as a margin

LocalSearch = Callable[[Array, IntArray], float]
"""Cost of the incumbent after a local search from x (n,) with alternatives (C,)."""


@dataclass
class _ReduceNode:
    """A node, with what its parent proves of it until it is processed."""

    box: CertificateBox | None
    proof: LeafProof
    split: int = -1
    split_value: float = 0.0
    below: int = -1
    above: int = -1


class BranchAndReduce:
    """Best-first branch and reduce, until the gap is proved or a limit is reached."""

    def __init__(
        self, instance: Instance, gap: float, best: float, search_locally: LocalSearch
    ) -> None:
        """Begin with the root.

        Args:
            instance: Instance with products.
            gap: Relative gap to prove.
            best: Cost of the incumbent.
            search_locally: Local search for incumbents.

        Raises:
            UsageError: A factor of a product is not bounded.
        """
        self._instance, self._gap, self._best, self._search_locally = (
            instance,
            gap,
            best,
            search_locally,
        )
        self.zero_cost = compute_zero_cost(instance)
        self._proofs = LeafProofs(instance)
        self._rows, root = self._proofs.checker.rows, self._proofs.checker.root
        start = LeafProof(-np.inf, self._proofs.zero_multipliers(root))
        self._nodes = [_ReduceNode(root, start)]
        self._heap: list[tuple[float, int]] = [(-np.inf, 0)]
        self._width = np.maximum(root.upper - root.lower, 1e-300)
        max_coefficient = abs(self._rows.G[:, self._rows.w]).max(axis=0)
        self._weight = np.asarray(max_coefficient.todense()).ravel()
        self.num_nodes = 0  # nodes processed
        self.closed_bound = np.inf  # least bound of closed nodes

    @property
    def bound(self) -> float:
        """Lower bound on the optimum."""
        return min(self.closed_bound, self._heap[0][0] if self._heap else np.inf, self._best)

    @property
    def is_finished(self) -> bool:
        """Return whether no node is open."""
        return not self._heap

    def run(self, deadline: float, max_nodes: int) -> None:
        """Process nodes until the gap is proved or a limit is reached.

        Args:
            deadline: Time of `time.perf_counter` [s].
            most: Largest number of nodes.
        """
        while self._heap and self.num_nodes < max_nodes and time.perf_counter() < deadline:
            _, index = heapq.heappop(self._heap)
            self._process(self._nodes[index])

    @property
    def _cutoff(self) -> float:
        """Bound from which a node is closed."""
        gap = (1.0 - _SAFE) * self._gap
        return compute_closing_bound(self._best, gap, self.zero_cost)

    def _process(self, node: _ReduceNode) -> None:
        """Tighten a node's bounds, then close or split it."""
        assert node.box is not None
        self.num_nodes += 1
        box, node.box = tighten_box(self._rows, node.box), None
        if box.empty:
            node.proof = node.proof._replace(bound=np.inf)
            return
        if node.proof.bound < self._cutoff and self._bound_and_split(node, box):
            return
        self.closed_bound = min(self.closed_bound, node.proof.bound)

    def _bound_and_split(self, node: _ReduceNode, box: CertificateBox) -> bool:
        """Solve a node's relaxation, and split the node unless its bound closes it."""
        rows = append_envelopes(self._rows, box.lower, box.upper)
        relaxation = compute_leaf_multipliers(self._instance, rows, box, empty=False)
        candidates = [
            self._proofs.zero_multipliers(box) if relaxation is None else relaxation.multipliers
        ]
        if (
            candidates[0].point is None
            and self._proofs.check(rows, box, candidates[0]).bound < np.inf
        ):
            # The solver reports infeasibility, but its multipliers do not prove it
            elastic = compute_leaf_multipliers(self._instance, rows, box, empty=True)
            candidates += [] if elastic is None else [elastic.multipliers]
        for multipliers in candidates:
            proof = self._proofs.check(rows, box, multipliers)
            node.proof = proof if proof.bound > node.proof.bound else node.proof
        if node.proof.bound >= self._cutoff:
            return False
        if relaxation is None:
            return self._branch(node, box, 0.5 * (box.lower + box.upper))
        if self.num_nodes <= _OFTEN or self.num_nodes % _EVERY == 0:
            self._best = min(self._best, self._search_locally(*self._round_choices(relaxation.v)))
        return node.proof.bound < self._cutoff and self._branch(node, box, relaxation.v)

    def _round_choices(self, v: Array) -> tuple[Array, IntArray]:
        """Return x and the likeliest alternative of each choice."""
        chosen, z = [], self._instance.size
        for choice in self._instance.choices:
            chosen.append(int(np.argmax(v[z : z + len(choice.alternatives)])))
            z += len(choice.alternatives)
        return v[: self._instance.size], np.array(chosen, np.int64)

    def _branch(self, node: _ReduceNode, box: CertificateBox, v: Array) -> bool:
        """Split at the integer or factor that matters most; False if every range is too thin."""
        j, value = _select_split(self._rows, box, v, self._weight, self._width)
        if j < 0:
            return False
        node.split, node.split_value = j, value
        node.below, node.above = len(self._nodes), len(self._nodes) + 1
        for side in box.bisect(self._rows, j, value):
            heapq.heappush(self._heap, (node.proof.bound, len(self._nodes)))
            self._nodes.append(_ReduceNode(side, node.proof))
        return True

    def build_certificate(self) -> Certificate:
        """Build the certificate; open nodes have what their parents prove."""
        writer, stack = CertificateWriter(), [0]
        while stack:
            node = self._nodes[stack.pop()]
            if node.split < 0:
                writer.append_leaf(node.proof)
            else:
                writer.append_split(node.split, node.split_value)
                stack += [node.above, node.below]
        return writer.build(self._instance)


def _select_split(
    rows: CertificateRows, box: CertificateBox, v: Array, weight: Array, root_width: Array
) -> tuple[int, float]:
    """Select variable and value of a split: an open integer first, then a factor; -1 for none.

    Args:
        rows: Rows of the statement.
        box: Ranges of the node.
        v: (N,) solution of its relaxation.
        weight: (K,) largest violation of a row for each unit of error of a product.
        whole: (N,) widths of the root's ranges.
    """
    width = box.upper - box.lower
    integers = np.flatnonzero(rows.integer & (width > 0.0))
    if len(integers):
        error = np.abs(v[integers] - np.round(v[integers]))
        j = int(integers[np.argmax(np.where(error > _INTEGRAL, error, 0.0))])
        return j, float(np.clip(np.floor(v[j]), box.lower[j], box.upper[j] - 1.0))
    error = np.abs(v[rows.w] - v[rows.first] * v[rows.second]) * weight
    size = np.maximum(1.0, np.maximum(np.abs(box.lower), np.abs(box.upper)))
    thin = width <= _THIN * size
    error[thin[rows.first] & thin[rows.second]] = -1.0
    q = int(np.argmax(error)) if len(error) else -1
    if q < 0 or error[q] < 0.0:
        return -1, 0.0
    factors = np.array([rows.first[q], rows.second[q]])
    relative_width = np.where(thin[factors], -1.0, width[factors] / root_width[factors])
    j = int(factors[np.argmax(relative_width)])
    value = _MIDDLE * 0.5 * (box.lower[j] + box.upper[j]) + (1.0 - _MIDDLE) * v[j]
    min_distance = _ENDS * width[j]
    return j, float(np.clip(value, box.lower[j] + min_distance, box.upper[j] - min_distance))
