"""The reduced mixed-integer program of a cluster of solutions (ReDUCE, section 7.2.2.1).

Of each partition only the pieces remain in which solutions of the cluster lie, each tightened to
the range of these solutions. Of the stated binaries and choices only the combinations that occur
remain. Both get new binaries: ceil(log2 N) for N pieces, ceil(log2 K) for K combinations. Bounds
are tightened to the hull of the pieces, and big-M constants with them.

The published method keeps whole pieces. Tightening them gives tighter envelopes, so that programs
are solved faster and more of their optima have the right integers.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
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
from climbplan.reformulations.extension import Extension, TripletRows, extend_instance
from climbplan.reformulations.grids import Partition, build_code
from climbplan.reformulations.mccormick import EnvelopeForm, McCormick

MARGIN = 0.05  # margin around the solutions in a piece, as a fraction of its width


@dataclass(frozen=True)
class ClusterReduction:
    """The integers of a program that remain in one cluster."""

    partitions: tuple[Partition, ...]  # with the occupied pieces only
    values: Array  # (K, B) combinations of the stated binaries
    alternatives: IntArray  # (K, C) combinations of the choices
    squares: Squares

    @classmethod
    def of(
        cls,
        partitions: Sequence[Partition],
        points: Array,
        alternatives: IntArray,
        integer: BoolArray,
        squares: Squares = "envelope",
        room: float = MARGIN,
    ) -> ClusterReduction:
        """Build the reduction of a cluster's solutions.

        Args:
            partitions: Grids of factors.
            points: (S, N) solutions.
            alternatives: (S, C) chosen alternatives.
            integer: (N,) mask of integers.
            squares: Treatment of squares.
            room: Margin around the solutions in a piece, as a fraction of its width; infinite for
                whole pieces, as published.
        """
        occupied = [_restrict_to_points(partition, points, room) for partition in partitions]
        key = np.hstack([np.round(points[:, integer]), alternatives])
        combinations = np.unique(key, axis=0)
        B = int(np.count_nonzero(integer))
        return cls(
            tuple(occupied), combinations[:, :B], combinations[:, B:].astype(np.int64), squares
        )

    @property
    def binary_count(self) -> int:
        """Number of binaries of the reduced program."""
        pieces = sum(p.count_binaries("log2") for p in self.partitions)
        return pieces + (len(self.values) - 1).bit_length()

    def build_form(self, instance: Instance) -> ReducedForm:
        """Build the parts that instances of the program share, for many parameters."""
        low, high = instance.lower.copy(), instance.upper.copy()
        for partition in self.partitions:
            variables = partition.variables
            low[variables] = np.maximum(low[variables], partition.lower.min(axis=0))
            high[variables] = np.minimum(high[variables], partition.upper.max(axis=0))
        if len(self.values):
            low[instance.integer] = np.maximum(low[instance.integer], self.values.min(axis=0))
            high[instance.integer] = np.minimum(high[instance.integer], self.values.max(axis=0))
        tight = replace(instance, lower=low, upper=high)
        envelopes = None
        if instance.products.count:
            envelopes = McCormick(self.partitions, "log2", self.squares).form(tight)
        return ReducedForm(self, low, high, envelopes)


def _restrict_to_points(partition: Partition, points: Array, slack: float) -> Partition:
    """Return the pieces in which points (S, N) lie, tightened to these points."""
    piece = np.array([partition.find_piece(x) for x in points], np.int64)
    occupied, piece_of_point = np.unique(piece, return_inverse=True)
    lower, upper = partition.lower[occupied], partition.upper[occupied]
    if math.isfinite(slack):
        values, margin = points[:, partition.variables], slack * (upper - lower)
        low, high = np.full(lower.shape, np.inf), np.full(upper.shape, -np.inf)
        np.minimum.at(low, piece_of_point, values)
        np.maximum.at(high, piece_of_point, values)
        # A point may lie outside its piece by a tolerance; the piece's own end is kept there.
        low, high = np.clip(low - margin, lower, upper), np.clip(high + margin, lower, upper)
        lower, upper = low, high
    return Partition(partition.variables, lower, upper)


@dataclass(frozen=True)
class ReducedProgram:
    """A mixed-integer convex instance whose first variables are the statement's."""

    instance: Instance
    groups: tuple[IntArray, ...]  # columns of the binaries of each choice

    def alternatives(self, x: Array) -> IntArray:
        """Return the chosen alternative of each choice in a solution."""
        return np.array([int(np.argmax(x[group])) for group in self.groups], np.int64)


@dataclass(frozen=True)
class ReducedForm:
    """A reduction prepared for instances of one program."""

    reduction: ClusterReduction
    lower: Array  # (N,)
    upper: Array  # (N,)
    envelopes: EnvelopeForm | None

    def build(self, instance: Instance) -> ReducedProgram:
        """Build the reduced program at an instance's parameters.

        Raises:
            UsageError: A row has no big-M because bounds are missing.
        """
        # Smooth rows are added by the program at fixed integers, which makes the answer exact
        tight = replace(instance, lower=self.lower, upper=self.upper, smooth=None)
        linear = tight if self.envelopes is None else self.envelopes.at(tight).instance
        flat = BigM().apply(linear)
        return ReducedProgram(
            self._encode_combinations(instance, flat.instance, flat.binaries), flat.binaries
        )

    def _encode_combinations(
        self, source: Instance, flat: Instance, groups: tuple[IntArray, ...]
    ) -> Instance:
        """Encode binaries and choices as sum_k weight_k combination_k by a binary code."""
        reduction = self.reduction
        K = len(reduction.values)
        stated = np.flatnonzero(source.integer)
        columns = np.concatenate([stated, *groups]).astype(np.int64)
        blocks = [reduction.values]
        for c, group in enumerate(groups):
            blocks.append(np.eye(len(group))[reduction.alternatives[:, c]])
        table = np.hstack(blocks)  # (K, columns)
        codes = build_code(K)
        bits = codes.shape[1]
        weight = np.arange(flat.size, flat.size + K)
        bit = np.arange(flat.size + K, flat.size + K + bits)
        rows = TripletRows()
        rows.add(1, [(0, weight, 1.0)], 1.0, 1.0)
        if bits:
            k, b = np.nonzero(codes)
            rows.add(bits, [(b, weight[k], 1.0), (np.arange(bits), bit, -1.0)], 0.0, 0.0)
        if len(columns):
            k, j = np.nonzero(table)
            rows.add(
                len(columns),
                [(j, weight[k], table[k, j]), (np.arange(len(columns)), columns, -1.0)],
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
        return extend_instance(replace(flat, integer=integer), extension)
