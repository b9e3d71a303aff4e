"""The certificate of a search: a tree of splits whose leaves have multipliers that are checked.

The search's leaves say where to split and which multipliers to try first. Where these prove too
little the leaf is solved again, by the search and then in the rows of the statement; and where that
is not enough, it is split further. Each proof is one that the checker has accepted.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import IntArray
from climbplan.certificates.box import Box, narrowed
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.rows import StatedRows, with_planes
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.cover import Leaves, Part
from climbplan.solvers.mixed_integer.leaf_multipliers import leaf_multipliers
from climbplan.solvers.mixed_integer.leaf_proofs import LeafProofs, Proved, Written
from climbplan.solvers.mixed_integer.search import settle
from climbplan.solvers.mixed_integer.telling import Multipliers, Searched, Telling
from climbplan.solvers.result import LEAST_OBJECTIVE

_LEFT = (place.OPEN, place.CLOSED, place.EMPTY_NODE, place.LEFT)
_SHORT = 1e-7  # by which a leaf may prove less than the tree says, relative, or a tenth of the gap
_THIN = 1e-7  # relative width from which a factor's range is not split
_LEAST_PROOF = 1.0  # [s] that a certificate may take after the time limit
_MOST_SPLITS = 10_000  # beyond those of the search


def certificate_of(
    instance: Instance, of: Searched, bound: float, deadline: float = np.inf
) -> Certificate:
    """What a tree that has run proves, as far as it has come.

    bound: what it says itself; leaves are worked on only where they prove less. deadline: of
    `time.perf_counter` [s], after which they keep what they have, and the certificate proves less.
    """
    best, gap = float(of.search.real[place.BEST]), float(of.search.real[place.GAP])
    enough = best - gap * max(abs(best), LEAST_OBJECTIVE) if np.isfinite(best) else np.inf
    short = min(_SHORT, 0.1 * gap) * max(abs(bound), 1.0) if np.isfinite(bound) else 0.0
    return _Prover(instance, min(enough, bound - short), deadline, of).certificate()


def proof_deadline(begin: float, deadline: float) -> float:
    """Until when a search that began then may prove what it has found, of `time.perf_counter` [s].

    After its deadline as long again as it took, so that the limit limits proofs, too.
    """
    now = time.perf_counter()
    return np.inf if now < deadline else now + max(now - begin, _LEAST_PROOF)


def certificate_of_nothing(instance: Instance, enough: float = np.inf) -> Certificate:
    """That an instance has no point at all, or costs enough, found before any search."""
    return _Prover(instance, enough, np.inf, None).certificate()


class _Prover:
    """Leaves in turn, each with what proves most of it."""

    def __init__(
        self, instance: Instance, enough: float, deadline: float, of: Searched | None
    ) -> None:
        self._instance, self._enough, self._deadline, self._of = instance, enough, deadline, of
        self._proofs = LeafProofs(instance)
        self._checker = self._proofs.checker
        self._telling: Telling | None = None
        self._further = 0  # splits that the search did not make
        self._nodes = np.zeros(0, np.int64)
        if of is not None:
            states = of.tree.state[: int(of.search.whole[place.COUNT])]
            self._nodes = np.flatnonzero(np.isin(states, _LEFT))
            low, high = of.tree.low[self._nodes], of.tree.high[self._nodes]
            self._leaves = Leaves(low.astype(np.int64), high.astype(np.int64))
            self._places = _places(instance, self._checker.rows, of)

    def certificate(self) -> Certificate:
        """All splits and leaves in preorder."""
        out, of = Written(), self._of
        root = None
        if of is not None:
            numbers = of.program.numbers
            root = Part(numbers.lowest, numbers.highest, np.arange(len(self._nodes)))
        waiting: list[tuple[Box, Part | None, int]] = [(self._checker.root, root, -1)]
        while waiting:
            box, part, leaf = waiting.pop()
            box = narrowed(self._checker.rows, box)
            part = None if part is None else self._leaves.meeting(part)
            if part is not None:
                leaf = self._leaves.holding(part)
                if leaf < 0 and len(part.among):
                    split = self._leaves.split(part)
                    j, at = self._place(split.entity, split.value)
                    below, above = box.halves(self._checker.rows, j, at)
                    out.add_split(j, at)
                    waiting += [(above, split.above, -1), (below, split.below, -1)]
                    continue
            proved = self._proved(box, leaf)
            j, at = (-1, 0.0) if proved.bound >= self._enough else self._further_split(box)
            if j < 0:
                out.add_leaf(proved)
            else:
                out.add_split(j, at)
                below, above = box.halves(self._checker.rows, j, at)
                waiting += [(above, None, leaf), (below, None, leaf)]
        return out.certificate(self._instance)

    def _place(self, entity: int, value: int) -> tuple[int, float]:
        """Variable of v and number at which an entity is split behind a value."""
        assert self._of is not None
        spatial = self._of.program.numbers.spatial
        if spatial.cell[entity] == 0.0:
            return int(self._places[entity]), float(value)
        at = spatial.left[entity] + spatial.cell[entity] * (value + 1)
        return int(self._places[entity]), float(at)

    def _proved(self, box: Box, leaf: int) -> Proved:
        """The best proof of a leaf whose box is narrowed, tried until one is enough."""
        if box.empty:
            return Proved(np.inf, self._proofs.nothing(self._checker.root))
        rows = with_planes(self._checker.rows, box.lower, box.upper)
        best = Proved(-np.inf, self._proofs.nothing(box))
        for found in self._attempts(rows, box, leaf):
            proved = self._proofs.tried(rows, box, found)
            best = proved if proved.bound > best.bound else best
            if best.bound >= self._enough:
                break
        return best

    def _attempts(self, rows: StatedRows, box: Box, leaf: int) -> Iterator[Multipliers]:
        """Multipliers from the cheapest to the dearest."""
        of = self._of
        if of is None or not len(self._checker.rows.w):  # of products the box alone says little
            yield self._proofs.nothing(box)
        late = time.perf_counter() >= self._deadline
        if of is not None and leaf >= 0:
            node = int(self._nodes[leaf])
            if not len(self._checker.rows.w):  # envelopes are those of the node looked at last
                yield self._told(node, rows, box)
            if not late:
                settle(of.program.numbers, of.search, of.tree, node)
                told = self._told(node, rows, box)
                yield told
                if np.isinf(self._enough):
                    yield told._replace(point=None)
        if late:
            return
        for empty in (True, False) if np.isinf(self._enough) else (False, True):
            found = leaf_multipliers(self._instance, rows, box, empty)
            if found is not None:
                yield found.multipliers

    def _told(self, node: int, rows: StatedRows, box: Box) -> Multipliers:
        """What the search has stored of a leaf."""
        assert self._of is not None
        if self._telling is None or self._telling.used != self._of.used:  # tangents were found
            self._telling = Telling(self._instance, self._checker.rows, self._of)
        return self._telling.multipliers(node, rows, box)

    def _further_split(self, box: Box) -> tuple[int, float]:
        """Where to split a leaf that proves too little; -1 where there is nothing to split."""
        rows = self._checker.rows
        if self._further >= _MOST_SPLITS or time.perf_counter() >= self._deadline or box.empty:
            return -1, 0.0
        width = box.upper - box.lower
        open_ones = np.flatnonzero(rows.integer & (width > 0.0) & np.isfinite(width))
        if len(open_ones):
            j = int(open_ones[0])
            self._further += 1
            return j, float(np.floor(0.5 * (box.lower[j] + box.upper[j])))
        factors = np.unique(np.concatenate([rows.first, rows.second]))
        size = np.maximum(1.0, np.maximum(np.abs(box.lower), np.abs(box.upper)))
        factors = factors[np.isfinite(width[factors]) & (width > _THIN * size)[factors]]
        if not len(factors):
            return -1, 0.0
        root = self._checker.root
        j = int(factors[np.argmax(width[factors] / (root.upper - root.lower)[factors])])
        self._further += 1
        return j, float(0.5 * (box.lower[j] + box.upper[j]))


def _places(instance: Instance, rows: StatedRows, of: Searched) -> IntArray:
    """Where each entity of a search stands in v."""
    place_in_v = np.zeros(of.form.size, np.int64)
    n = instance.size
    place_in_v[: of.instance.size] = np.concatenate([np.arange(n), rows.w])
    z = n
    for choice, binaries in zip(instance.choices, of.form.choice, strict=True):
        place_in_v[binaries] = z + np.arange(len(binaries))  # a switch is 1 for the first
        z += len(choice.alternatives)
    return np.concatenate([place_in_v[of.program.entities], of.space]).astype(np.int64)
