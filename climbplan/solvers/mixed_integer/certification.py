"""Certify a search: a tree of splits whose leaves have checked multipliers.

The leaves of the search determine the splits and the multipliers that are tried first. Where these
prove too little, the leaf is solved again, by the search and then in the rows of the statement. If
this is not enough, the leaf is split further. The checker has accepted each proof.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import IntArray
from climbplan.certificates.box import CertificateBox, tighten_box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.rows import CertificateRows, append_envelopes
from climbplan.program.instance import Instance
from climbplan.progress import report_stage
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.leaf_boxes import LeafBoxes, Subdomain
from climbplan.solvers.mixed_integer.leaf_multipliers import compute_leaf_multipliers
from climbplan.solvers.mixed_integer.leaf_proofs import CertificateWriter, LeafProof, LeafProofs
from climbplan.solvers.mixed_integer.multiplier_map import MultiplierMap, Multipliers, SearchedTree
from climbplan.solvers.mixed_integer.search import resolve_leaf
from climbplan.solvers.result import compute_closing_bound, compute_zero_cost

_LEAF_STATES = (slots.OPEN, slots.CLOSED, slots.EMPTY_NODE, slots.GIVEN_UP)
_SHORTFALL = 1e-7  # relative amount by which a leaf may fall short of the tree's bound
_THIN = 1e-7  # relative width below which a factor's range is not split
_MIN_PROOF_TIME = 1.0  # least time for a certificate after the time limit [s]
_SHRINK = 1e-8  # relative, of multipliers where a variable has no bound
_MAX_SPLITS = 10_000  # largest number of splits beyond those of the search


def certify_search(
    instance: Instance, tree: SearchedTree, bound: float, cost: float, deadline: float = np.inf
) -> Certificate:
    """Build the certificate of a tree that has run, as far as it has come.

    Args:
        instance: The stated instance.
        tree: The tree.
        bound: Bound that is claimed; leaves are refined only where they prove less.
        cost: Cost of the incumbent, infinite without one.
        deadline: Time of `time.perf_counter` [s] after which leaves are refined no further, so that
            the certificate may prove less.
    """
    gap = float(tree.search.scalars[slots.GAP])
    required_bound = compute_closing_bound(cost, gap, compute_zero_cost(instance))
    tolerance = min(_SHORTFALL, 0.1 * gap) * max(abs(bound), 1.0) if np.isfinite(bound) else 0.0
    return _Prover(instance, min(required_bound, bound - tolerance), deadline, tree).certify()


def compute_proof_deadline(begin: float, deadline: float) -> float:
    """Return the time of `time.perf_counter` [s] until which a search may prove its result.

    After the search's deadline a proof may take as long as the search took.
    """
    now = time.perf_counter()
    return np.inf if now < deadline else now + max(now - begin, _MIN_PROOF_TIME)


def certify_without_search(instance: Instance, required_bound: float = np.inf) -> Certificate:
    """Build a certificate of infeasibility, or of a bound, that presolve has found."""
    return _Prover(instance, required_bound, np.inf, None).certify()


@dataclass
class SplitTree:
    """Splits of integers, by the nodes of a tree; node 0 is the root, and others are leaves."""

    splits: dict[int, tuple[int, float, int]] = field(default_factory=dict)

    def append(self, node: int, variable: int, value: float) -> tuple[int, int]:
        """Split a leaf in variable <= value and variable >= value + 1; return both children."""
        below = 2 * len(self.splits) + 1
        self.splits[node] = variable, value, below
        return below, below + 1


def certify_splits(
    instance: Instance, tree: SplitTree, required_bound: float, deadline: float = np.inf
) -> Certificate:
    """Build the certificate of a tree over integers, whose leaves are solved again.

    Args:
        instance: The stated instance.
        tree: The splits of a search.
        required_bound: Bound to prove; leaves are refined only where they prove less.
        deadline: Time of `time.perf_counter` [s] after which leaves prove what their boxes imply.
    """
    return _Prover(instance, required_bound, deadline, None, tree.splits).certify()


class _Prover:
    """Certifies leaves one after the other with the best proof of each."""

    def __init__(
        self,
        instance: Instance,
        required_bound: float,
        deadline: float,
        tree: SearchedTree | None,
        splits: Mapping[int, tuple[int, float, int]] | None = None,
    ) -> None:
        """Collect the leaves of a tree, or begin with the root without one."""
        self._splits = {} if splits is None else splits
        self._instance, self._required_bound, self._deadline, self._tree = (
            instance,
            required_bound,
            deadline,
            tree,
        )
        self._proofs = LeafProofs(instance)
        self._checker = self._proofs.checker
        self._multiplier_map: MultiplierMap | None = None
        self._num_extra_splits = 0
        self._nodes = np.zeros(0, np.int64)
        if tree is not None:
            states = tree.tree.state[: int(tree.search.counters[slots.NUM_NODES])]
            self._nodes = np.flatnonzero(np.isin(states, _LEAF_STATES))
            low, high = tree.tree.low[self._nodes], tree.tree.high[self._nodes]
            self._leaves = LeafBoxes(low.astype(np.int64), high.astype(np.int64))
            self._variable_of_entity = _locate_entities(instance, self._checker.rows, tree)

    def certify(self) -> Certificate:
        """Certify all leaves; splits and leaves are in preorder."""
        writer, tree = CertificateWriter(), self._tree
        root, first = None, 0 if self._splits else -1
        if tree is not None:
            numbers = tree.program.data
            root = Subdomain(numbers.root_low, numbers.root_high, np.arange(len(self._nodes)))
        stack: list[tuple[CertificateBox, Subdomain | None, int]] = [
            (self._checker.root, root, first)
        ]
        num_leaves = max(len(self._nodes), len(self._splits) + 1)
        while stack:
            report_stage("certify", min(len(writer.leaves) / num_leaves, 1.0))
            box, subdomain, leaf = stack.pop()
            box = tighten_box(self._checker.rows, box)
            subdomain = (
                None if subdomain is None else self._leaves.restrict_to_intersecting(subdomain)
            )
            if subdomain is not None:
                leaf = self._leaves.find_covering_leaf(subdomain)
                if leaf < 0 and len(subdomain.among):
                    split = self._leaves.split(subdomain)
                    j, value = self._locate_split(split.entity, split.value)
                    below, above = box.bisect(self._checker.rows, j, value)
                    writer.append_split(j, value)
                    stack += [(above, split.above, -1), (below, split.below, -1)]
                    continue
            if leaf in self._splits:
                j, value, child = self._splits[leaf]
                below, above = box.bisect(self._checker.rows, j, value)
                writer.append_split(j, value)
                stack += [(above, None, child + 1), (below, None, child)]
                continue
            proof = self._prove_leaf(box, leaf)
            j, value = (
                (-1, 0.0) if proof.bound >= self._required_bound else self._select_extra_split(box)
            )
            if j < 0:
                writer.append_leaf(proof)
            else:
                writer.append_split(j, value)
                below, above = box.bisect(self._checker.rows, j, value)
                leaf = leaf if tree is not None else -1
                stack += [(above, None, leaf), (below, None, leaf)]
        return writer.build(self._instance)

    def _locate_split(self, entity: int, cell: int) -> tuple[int, float]:
        """Return variable of v and value at which an entity is split after a cell or integer."""
        assert self._tree is not None
        spatial = self._tree.program.data.spatial
        if spatial.cell_width[entity] == 0.0:
            return int(self._variable_of_entity[entity]), float(cell)
        split_value = spatial.left[entity] + spatial.cell_width[entity] * (cell + 1)
        return int(self._variable_of_entity[entity]), float(split_value)

    def _prove_leaf(self, box: CertificateBox, leaf: int) -> LeafProof:
        """Return the best proof of a leaf with tightened bounds, tried until one suffices."""
        if box.empty:
            return LeafProof(np.inf, self._proofs.zero_multipliers(self._checker.root))
        rows = append_envelopes(self._checker.rows, box.lower, box.upper)
        best = LeafProof(-np.inf, self._proofs.zero_multipliers(box))
        for multipliers in self._generate_multipliers(rows, box, leaf):
            proof = self._proofs.check(rows, box, multipliers)
            best = proof if proof.bound > best.bound else best
            if best.bound >= self._required_bound:
                break
        return best

    def _generate_multipliers(
        self, rows: CertificateRows, box: CertificateBox, leaf: int
    ) -> Iterator[Multipliers]:
        """Yield multipliers of a leaf from the cheapest to the most expensive."""
        tree = self._tree
        if tree is None or not len(
            self._checker.rows.w
        ):  # the box alone implies little of products
            yield self._proofs.zero_multipliers(box)
        is_late = time.perf_counter() >= self._deadline
        if tree is not None and leaf >= 0:
            node = int(self._nodes[leaf])
            if not len(self._checker.rows.w):  # envelopes are those of the node processed last
                yield self._map_stored(node, rows, box)
            if not is_late:
                resolve_leaf(tree.program.data, tree.search, tree.tree, node)
                stored = self._map_stored(node, rows, box)
                yield stored
                if np.isinf(self._required_bound):
                    yield stored._replace(point=None)
        if is_late:
            return
        for empty in (True, False) if np.isinf(self._required_bound) else (False, True):
            relaxation = compute_leaf_multipliers(self._instance, rows, box, empty)
            if relaxation is not None:
                yield relaxation.multipliers
                if not (np.isfinite(box.lower) & np.isfinite(box.upper)).all():
                    yield _shrink(relaxation.multipliers)

    def _map_stored(self, node: int, rows: CertificateRows, box: CertificateBox) -> Multipliers:
        """Return the multipliers that the search has stored of a leaf."""
        assert self._tree is not None
        if (
            self._multiplier_map is None or self._multiplier_map.num_rows != self._tree.num_rows
        ):  # tangents were found
            self._multiplier_map = MultiplierMap(self._instance, self._checker.rows, self._tree)
        return self._multiplier_map.map_leaf(node, rows, box)

    def _select_extra_split(self, box: CertificateBox) -> tuple[int, float]:
        """Select a split of a leaf that proves too little; -1 where nothing can be split."""
        rows = self._checker.rows
        if (
            self._num_extra_splits >= _MAX_SPLITS
            or time.perf_counter() >= self._deadline
            or box.empty
        ):
            return -1, 0.0
        width = box.upper - box.lower
        open_integers = np.flatnonzero(rows.integer & (width > 0.0) & np.isfinite(width))
        if len(open_integers):
            j = int(open_integers[0])
            self._num_extra_splits += 1
            return j, float(np.floor(0.5 * (box.lower[j] + box.upper[j])))
        factors = np.unique(np.concatenate([rows.first, rows.second]))
        size = np.maximum(1.0, np.maximum(np.abs(box.lower), np.abs(box.upper)))
        factors = factors[np.isfinite(width[factors]) & (width > _THIN * size)[factors]]
        if not len(factors):
            return -1, 0.0
        root = self._checker.root
        j = int(factors[np.argmax(width[factors] / (root.upper - root.lower)[factors])])
        self._num_extra_splits += 1
        return j, float(0.5 * (box.lower[j] + box.upper[j]))


def _shrink(multipliers: Multipliers) -> Multipliers:
    """Return multipliers for boxes that are open, where a slope of the wrong sign proves nothing.

    With the cost they are slightly smaller, so that its sign decides where slopes are near zero.
    Without it, those that only rounding has left are zero.
    """
    rows, ball = multipliers.rows, multipliers.ball
    if multipliers.point is not None:
        return multipliers._replace(rows=(1.0 - _SHRINK) * rows, ball=(1.0 - _SHRINK) * ball)
    smallest = _SHRINK * max(np.abs(rows).max(initial=0.0), np.abs(ball).max(initial=0.0))
    return multipliers._replace(
        rows=np.where(np.abs(rows) > smallest, rows, 0.0),
        ball=np.where(np.abs(ball) > smallest, ball, 0.0),
    )


def _locate_entities(instance: Instance, rows: CertificateRows, tree: SearchedTree) -> IntArray:
    """Return the index in v of each entity of a search."""
    place_in_v = np.zeros(tree.form.size, np.int64)
    n = instance.size
    place_in_v[: tree.instance.size] = np.concatenate([np.arange(n), rows.w])
    z = n
    for choice, binaries in zip(instance.choices, tree.form.choice, strict=True):
        place_in_v[binaries] = z + np.arange(len(binaries))  # a switch is 1 for the first
        z += len(choice.alternatives)
    return np.concatenate([place_in_v[tree.program.entities], tree.space]).astype(np.int64)
