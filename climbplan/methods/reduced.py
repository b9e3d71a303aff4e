"""The reduced mixed-integer program of a cluster of solutions (ReDUCE, section 7.2.2.1).

Of each partition only the pieces stay that solutions of the cluster lie in, each shrunk to where in
it they lie, and of the stated binaries and choices only the combinations that occur. Both get new
binaries, as many as their numbers need: ceil(log2 N) of N pieces, ceil(log2 K) of K combinations.
Bounds shrink to the hull of the pieces, and big-M constants with them.

Shrinking is ours: on 24 bookshelf scenes (10,000 solved ones, HiGHS) programs took 46 s together
instead of some 140 s, and more of their optima had the right integers, for envelopes half as thick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.envelopes import Squares
from climbplan.reformulations.extension import Extension, RowStack, extended
from climbplan.reformulations.grids import Partition, code
from climbplan.reformulations.mccormick import EnvelopeForm, McCormick

ROOM = 0.05  # of a piece's width, left around the solutions in it


@dataclass(frozen=True)
class Reduction:
    """What is left of a program's integers in one cluster."""

    partitions: tuple[Partition, ...]  # with the occupied pieces only
    values: Array  # (K, B) combinations of the stated binaries
    alternatives: IntArray  # (K, C) and of the choices
    squares: Squares

    @classmethod
    def of(
        cls,
        partitions: Sequence[Partition],
        points: Array,
        alternatives: IntArray,
        integer: BoolArray,
        squares: Squares = "envelope",
        room: float = ROOM,
    ) -> Reduction:
        """From the cluster's solutions: points (S, N), alternatives (S, C); integer: (N,) bool.

        room: share of a piece's width that is kept around the solutions in it; infinite for whole
        pieces, as published.
        """
        kept = [_occupied(partition, points, room) for partition in partitions]
        key = np.hstack([np.round(points[:, integer]), alternatives])
        combinations = np.unique(key, axis=0)
        B = int(np.count_nonzero(integer))
        return cls(tuple(kept), combinations[:, :B], combinations[:, B:].astype(np.int64), squares)

    @property
    def binary_count(self) -> int:
        """Binaries of the reduced program."""
        pieces = sum(p.binary_count("log2") for p in self.partitions)
        return pieces + (len(self.values) - 1).bit_length()

    def form(self, instance: Instance) -> ReducedForm:
        """What instances of the program share, to be used for many parameters."""
        low, high = instance.lower.copy(), instance.upper.copy()
        for partition in self.partitions:
            at = partition.variables
            low[at] = np.maximum(low[at], partition.lower.min(axis=0))
            high[at] = np.minimum(high[at], partition.upper.max(axis=0))
        if len(self.values):
            low[instance.integer] = np.maximum(low[instance.integer], self.values.min(axis=0))
            high[instance.integer] = np.minimum(high[instance.integer], self.values.max(axis=0))
        tight = replace(instance, lower=low, upper=high)
        envelopes = None
        if instance.products.count:
            envelopes = McCormick(self.partitions, "log2", self.squares).form(tight)
        return ReducedForm(self, low, high, envelopes)


def _occupied(partition: Partition, points: Array, room: float) -> Partition:
    """The pieces that points (S, N) lie in, no larger than these need."""
    piece = np.array([partition.piece(x) for x in points], np.int64)
    used, at = np.unique(piece, return_inverse=True)
    lower, upper = partition.lower[used], partition.upper[used]
    if math.isfinite(room):
        values, spare = points[:, partition.variables], room * (upper - lower)
        low, high = np.full(lower.shape, np.inf), np.full(upper.shape, -np.inf)
        np.minimum.at(low, at, values)
        np.maximum.at(high, at, values)
        # A point may lie outside its piece by a tolerance: the piece's own end holds there.
        low, high = np.clip(low - spare, lower, upper), np.clip(high + spare, lower, upper)
        lower, upper = low, high
    return Partition(partition.variables, lower, upper)


@dataclass(frozen=True)
class ReducedProgram:
    """A mixed-integer convex instance whose first variables are the statement's."""

    instance: Instance
    groups: tuple[IntArray, ...]  # columns of the binaries of each choice

    def alternatives(self, x: Array) -> IntArray:
        """Chosen alternative of each choice in a solution."""
        return np.array([int(np.argmax(x[group])) for group in self.groups], np.int64)


@dataclass(frozen=True)
class ReducedForm:
    """A reduction made ready for instances of one program."""

    reduction: Reduction
    lower: Array  # (N,)
    upper: Array  # (N,)
    envelopes: EnvelopeForm | None

    def at(self, instance: Instance) -> ReducedProgram:
        """The reduced program at an instance's parameters.

        Raises UsageError naming a row that has no big-M for want of bounds.
        """
        # Smooth rows are left to the pinned program, which makes the answer exact
        tight = replace(instance, lower=self.lower, upper=self.upper, smooth=None)
        linear = tight if self.envelopes is None else self.envelopes.at(tight).instance
        flat = BigM().apply(linear)
        return ReducedProgram(self._combined(instance, flat.instance, flat.binaries), flat.binaries)

    def _combined(self, source: Instance, flat: Instance, groups: tuple[IntArray, ...]) -> Instance:
        """Stated binaries and choices as sum_k share_k combination_k, shares chosen by a code."""
        reduction = self.reduction
        K = len(reduction.values)
        stated = np.flatnonzero(source.integer)
        columns = np.concatenate([stated, *groups]).astype(np.int64)
        parts = [reduction.values]
        for c, group in enumerate(groups):
            parts.append(np.eye(len(group))[reduction.alternatives[:, c]])
        table = np.hstack(parts)  # (K, columns)
        codes = code(K)
        bits = codes.shape[1]
        share = np.arange(flat.size, flat.size + K)
        bit = np.arange(flat.size + K, flat.size + K + bits)
        rows = RowStack()
        rows.add(1, [(0, share, 1.0)], 1.0, 1.0)
        if bits:
            k, b = np.nonzero(codes)
            rows.add(bits, [(b, share[k], 1.0), (np.arange(bits), bit, -1.0)], 0.0, 0.0)
        if len(columns):
            k, j = np.nonzero(table)
            rows.add(
                len(columns),
                [(j, share[k], table[k, j]), (np.arange(len(columns)), columns, -1.0)],
                0.0,
                0.0,
            )
        integer = flat.integer.copy()
        integer[columns] = False  # they follow from the code
        extension = Extension(
            np.zeros(K + bits),
            np.ones(K + bits),
            np.concatenate([np.zeros(K, bool), np.ones(bits, bool)]),
            rows.matrix(flat.size + K + bits),
            rows.lower,
            rows.upper,
        )
        return extended(replace(flat, integer=integer), extension)
