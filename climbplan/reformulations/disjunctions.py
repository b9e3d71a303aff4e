"""Choices and implications as rows over binaries: big-M from bounds, or the convex hull.

Both are exact: the binaries of a choice (one an alternative, summing to 1) follow the variables of
the instance, in the order of the choices. `BigM` adds no other variables; `ConvexHull` adds a copy
of the point for each alternative (Balas 1998) and has the tighter relaxation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import Box, propagated_box
from climbplan.program.instance import Choice, Instance
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import Extension, RowStack, extended, no_implications


@dataclass(frozen=True)
class Disjoined(Reformulated):
    """An instance without choices and implications, and where the binaries of choices are."""

    binaries: tuple[IntArray, ...]  # of each choice, one an alternative

    def alternatives(self, x: Array) -> IntArray:
        """Chosen alternative of each choice in a solution (n',)."""
        return np.array([int(np.argmax(x[group])) for group in self.binaries], np.int64)


@dataclass(frozen=True)
class BigM(Reformulation[Disjoined]):
    """Rows that a binary switches off by a constant computed from bounds, tight for each row."""

    def apply(self, instance: Instance) -> Disjoined:
        """Raises UsageError naming the first row whose big-M is infinite."""
        box = propagated_box(instance)
        build = _Build.of(instance)
        for choice, group in zip(instance.choices, build.groups, strict=True):
            _choice_by_bounds(build, choice, group, box)
        _implications_by_bounds(build, instance, box, np.arange(instance.implications.count))
        return build.done()


@dataclass(frozen=True)
class ConvexHull(Reformulation[Disjoined]):
    """Copies of the variables for each alternative, scaled by its binary.

    An implication is the union of its rows (where the binary has the value) and the box. Rows with
    products are hulls in their scalar value, which is `BigM`'s row.
    """

    def apply(self, instance: Instance) -> Disjoined:
        """Raises UsageError naming the choice or implication with an unbounded point."""
        box = propagated_box(instance)
        build = _Build.of(instance)
        for choice, group in zip(instance.choices, build.groups, strict=True):
            _choice_by_copies(build, choice, group, box)
        implied = instance.implications
        bilinear = np.diff(sparse.csr_matrix(implied.Q).indptr) > 0
        _implications_by_bounds(build, instance, box, np.flatnonzero(bilinear))
        for binary in np.unique(implied.binary[~bilinear]):
            rows = np.flatnonzero((implied.binary == binary) & ~bilinear)
            _implications_by_copies(build, instance, box, int(binary), rows)
        return build.done()


@dataclass
class _Build:
    """An extension that grows: its variables, rows, and products within the rows."""

    instance: Instance
    rows: RowStack
    lower: list[Array]
    upper: list[Array]
    integer: list[bool]
    groups: list[IntArray]  # binaries of each choice
    Q: list[sparse.csr_matrix]

    @classmethod
    def of(cls, instance: Instance) -> _Build:
        build = cls(instance, RowStack(), [], [], [], [], [])
        for choice in instance.choices:
            count = len(choice.alternatives)
            group = build.variables(np.zeros(count), np.ones(count), integer=True)
            build.groups.append(group)
            build.add(1, [(np.zeros(count, int), group, 1.0)], 1.0, 1.0)
        return build

    def variables(self, lower: Array, upper: Array, integer: bool = False) -> IntArray:
        """New variables; their columns."""
        start = self.instance.size + len(self.integer)
        self.lower.append(lower)
        self.upper.append(upper)
        self.integer += [integer] * len(lower)
        return np.arange(start, start + len(lower))

    def add(
        self,
        count: int,
        entries: Sequence[tuple[ArrayLike, ...]],
        lower: ArrayLike,
        upper: ArrayLike,
        Q: sparse.csr_matrix | None = None,
    ) -> None:
        self.rows.add(count, entries, lower, upper)
        empty = sparse.csr_matrix((count, self.instance.products.count))
        self.Q.append(empty if Q is None else Q)

    def done(self) -> Disjoined:
        n, K = self.instance.size, self.instance.products.count
        bare = replace(self.instance, choices=(), implications=no_implications(n, K))
        extension = Extension(
            np.concatenate([np.zeros(0), *self.lower]),
            np.concatenate([np.zeros(0), *self.upper]),
            np.array(self.integer, bool),
            self.rows.matrix(n + len(self.integer)),
            self.rows.lower,
            self.rows.upper,
            sparse.vstack(self.Q).tocsr() if self.Q else None,
        )
        groups = tuple(self.groups)
        return Disjoined(extended(bare, extension), n, relaxation=False, binaries=groups)


def _triplets(rows: sparse.csr_matrix) -> tuple[Array, Array, Array]:
    entry = sparse.coo_matrix(rows)
    return entry.row, entry.col, entry.data


def _choice_by_bounds(build: _Build, choice: Choice, group: IntArray, box: Box) -> None:
    """a y <= b where alternative r holds, and where s holds its largest value there:
    a y <= b z_r + sum_s M_s z_s, each M_s from the vertices of s or from the box.
    """
    for r, polytope in enumerate(choice.alternatives):
        for a, low, high in (
            (polytope.A, np.full(len(polytope.b), -np.inf), polytope.b),
            (polytope.C, polytope.c, polytope.c),
        ):
            rows = sparse.csr_matrix(sparse.csr_matrix(a) @ choice.E)
            reach = box.interval(rows)
            offset = a @ choice.e
            least = np.tile((reach.lower + offset)[:, None], len(group))
            most = np.tile((reach.upper + offset)[:, None], len(group))
            for s, other in enumerate(choice.alternatives):
                if other.vertices is not None:
                    value = a @ other.vertices.T
                    least[:, s] = np.maximum(least[:, s], value.min(axis=1))
                    most[:, s] = np.minimum(most[:, s], value.max(axis=1))
            least[:, r], most[:, r] = np.maximum(low, least[:, r]), np.minimum(high, most[:, r])
            name = f"{choice.name}, alternative {polytope.name}"
            for bound, sign, given in ((most, 1.0, high), (least, -1.0, low)):
                kept = np.flatnonzero(np.isfinite(given))
                infinite = kept[~np.isfinite(bound[kept]).all(axis=1)]
                if len(infinite):
                    raise UsageError(
                        f"{name}: row {infinite[0]} is not bounded, so it has no big-M; "
                        "give its variables bounds"
                    )
                count = len(kept)
                i, j, value = _triplets(rows[kept])
                spread = (np.arange(count)[:, None], group, -sign * bound[kept])
                build.add(count, [(i, j, sign * value), spread], -np.inf, -sign * offset[kept])


def _implications_by_bounds(build: _Build, instance: Instance, box: Box, which: IntArray) -> None:
    """z = v implies row <= u: row + (M - u) [z = v] <= M with M the row's largest value."""
    implied = instance.implications
    rows, Q = implied.A[which], implied.Q[which]
    reach = box.interval(rows, Q)
    binary, value = implied.binary[which], implied.value[which]
    for bound, extreme, sign in (
        (implied.upper[which], reach.upper, 1.0),
        (implied.lower[which], reach.lower, -1.0),
    ):
        # Rows that hold over the whole box need no switch.
        kept = np.flatnonzero(np.isfinite(bound) & (sign * extreme > sign * bound))
        infinite = kept[~np.isfinite(extreme[kept])]
        if len(infinite):
            raise UsageError(
                f"{instance.name}: implication row {which[infinite[0]]} (on variable "
                f"{binary[infinite[0]]}) is not bounded, so it has no big-M; "
                "give its variables bounds"
            )
        count, at = len(kept), np.arange(len(kept))
        slack = sign * (extreme[kept] - bound[kept])
        on = value[kept]
        i, j, data = _triplets(rows[kept])
        build.add(
            count,
            [(i, j, sign * data), (at, binary[kept], np.where(on, slack, -slack))],
            -np.inf,
            np.where(on, sign * extreme[kept], sign * bound[kept]),
            sign * Q[kept],
        )


def _choice_by_copies(build: _Build, choice: Choice, group: IntArray, box: Box) -> None:
    """y = sum_r y_r, A_r y_r <= b_r z_r, C_r y_r = c_r z_r, y_r within the box times z_r."""
    d = choice.E.shape[0]
    reach = box.interval(choice.E)
    around = (reach.lower + choice.e, reach.upper + choice.e)
    copies = []
    for polytope, z in zip(choice.alternatives, group, strict=True):
        low, high = around
        if polytope.vertices is not None:
            low = np.maximum(low, polytope.vertices.min(axis=0))
            high = np.minimum(high, polytope.vertices.max(axis=0))
        if not (np.isfinite(low) & np.isfinite(high)).all():
            raise UsageError(
                f"{choice.name}, alternative {polytope.name}: its point is not bounded, "
                "which the convex hull needs; give its variables bounds"
            )
        copy = build.variables(np.minimum(low, 0.0), np.maximum(high, 0.0))
        _scaled_rows(build, sparse.csr_matrix(polytope.A), copy, z, None, polytope.b)
        _scaled_rows(build, sparse.csr_matrix(polytope.C), copy, z, polytope.c, polytope.c)
        _scaled_rows(build, sparse.identity(d, format="csr"), copy, z, low, high)
        copies.append((np.arange(d), copy, -1.0))
    build.add(d, [_triplets(choice.E), *copies], -choice.e, -choice.e)


def _implications_by_copies(
    build: _Build, instance: Instance, box: Box, binary: int, rows: IntArray
) -> None:
    """x = u + v: u holds the rows of z = 1 and the box times z, v those of z = 0 and 1 - z."""
    implied = instance.implications
    touched = np.unique(implied.A[rows].indices)
    low, high = box.lower[touched], box.upper[touched]
    if not (np.isfinite(low) & np.isfinite(high)).all():
        raise UsageError(
            f"{instance.name}: implication row {rows[0]} (on variable {binary}) has a variable "
            "without bounds, which the convex hull needs"
        )
    d = len(touched)
    parts = []
    for value in (True, False):
        copy = build.variables(np.minimum(low, 0.0), np.maximum(high, 0.0))
        held = rows[implied.value[rows] == value]
        A = sparse.csr_matrix(implied.A[held][:, touched])
        lower, upper = implied.lower[held], implied.upper[held]
        for a, least, most in ((A, lower, upper), (sparse.identity(d, format="csr"), low, high)):
            _scaled_rows(build, a, copy, binary, least, most, complement=not value)
        parts.append((np.arange(d), copy, -1.0))
    build.add(d, [(np.arange(d), touched, 1.0), *parts], 0.0, 0.0)


def _scaled_rows(
    build: _Build,
    A: sparse.csr_matrix,
    copy: IntArray,
    z: int,
    lower: Array | None,
    upper: Array | None,
    complement: bool = False,
) -> None:
    """lower z <= A copy <= upper z, with 1 - z in place of z for the complement."""
    for bound, sign in ((upper, 1.0), (lower, -1.0)):
        if bound is None:
            continue
        kept = np.flatnonzero(np.isfinite(bound))
        if len(kept) == 0:
            continue
        i, j, value = _triplets(A[kept])
        edge = sign * bound[kept]
        factor = edge if complement else -edge
        limit = edge if complement else np.zeros(len(kept))
        entries = [(i, copy[j], sign * value), (np.arange(len(kept)), z, factor)]
        build.add(len(kept), entries, -np.inf, limit)
