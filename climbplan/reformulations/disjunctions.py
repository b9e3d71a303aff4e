"""Choices and implications as rows over binaries: big-M from bounds, or the convex hull.

Both are exact. The binaries of a choice (one for each alternative, summing to 1) follow the
variables of the instance, in the order of the choices. `BigM` adds no other variables. `ConvexHull`
adds a copy of the point for each alternative (Balas 1998) and has the tighter relaxation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Choice, Instance
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import (
    Extension,
    TripletRows,
    create_no_implications,
    extend_instance,
)


@dataclass(frozen=True)
class DisjunctiveForm(Reformulated):
    """An instance without choices and implications, and the columns of the binaries of choices."""

    binaries: tuple[IntArray, ...]  # of each choice, one for each alternative

    def decode_alternatives(self, x: Array) -> IntArray:
        """Return the chosen alternative of each choice in a solution (n',)."""
        return np.array([int(np.argmax(x[group])) for group in self.binaries], np.int64)


@dataclass(frozen=True)
class BigM(Reformulation[DisjunctiveForm]):
    """Rows that a binary deactivates by a constant computed from bounds, tight for each row."""

    def apply(self, instance: Instance) -> DisjunctiveForm:
        """Build the rows.

        Raises:
            UsageError: The big-M of a row is infinite.
        """
        box = propagate_box(instance)
        build = _FormBuilder.begin(instance)
        for choice, group in zip(instance.choices, build.groups, strict=True):
            _add_choice_big_m(build, choice, group, box)
        _add_implication_big_m(build, instance, box, np.arange(instance.implications.count))
        return build.finish()


@dataclass(frozen=True)
class ConvexHull(Reformulation[DisjunctiveForm]):
    """Copies of the variables for each alternative, scaled by its binary.

    An implication is the union of its rows (where the binary has the value) and the box. Rows with
    products are hulls in their scalar value, which is `BigM`'s row.
    """

    def apply(self, instance: Instance) -> DisjunctiveForm:
        """Build the rows.

        Raises:
            UsageError: A choice or implication has an unbounded point.
        """
        box = propagate_box(instance)
        build = _FormBuilder.begin(instance)
        for choice, group in zip(instance.choices, build.groups, strict=True):
            _add_choice_hull(build, choice, group, box)
        implications = instance.implications
        bilinear = np.diff(sparse.csr_matrix(implications.Q).indptr) > 0
        _add_implication_big_m(build, instance, box, np.flatnonzero(bilinear))
        for binary in np.unique(implications.binary[~bilinear]):
            rows = np.flatnonzero((implications.binary == binary) & ~bilinear)
            _add_implication_hull(build, instance, box, int(binary), rows)
        return build.finish()


@dataclass
class _FormBuilder:
    """A growing extension: its variables, rows, and products within the rows."""

    instance: Instance
    rows: TripletRows
    lower: list[Array]
    upper: list[Array]
    integer: list[bool]
    groups: list[IntArray]  # binaries of each choice
    Q: list[sparse.csr_matrix]

    @classmethod
    def begin(cls, instance: Instance) -> _FormBuilder:
        """Begin with the binaries of choices."""
        build = cls(instance, TripletRows(), [], [], [], [], [])
        for choice in instance.choices:
            count = len(choice.alternatives)
            group = build.add_variables(np.zeros(count), np.ones(count), integer=True)
            build.groups.append(group)
            build.add_rows(1, [(np.zeros(count, int), group, 1.0)], 1.0, 1.0)
        return build

    def add_variables(self, lower: Array, upper: Array, integer: bool = False) -> IntArray:
        """Add variables and return their columns."""
        start = self.instance.size + len(self.integer)
        self.lower.append(lower)
        self.upper.append(upper)
        self.integer += [integer] * len(lower)
        return np.arange(start, start + len(lower))

    def add_rows(
        self,
        count: int,
        entries: Sequence[tuple[ArrayLike, ...]],
        lower: ArrayLike,
        upper: ArrayLike,
        Q: sparse.csr_matrix | None = None,
    ) -> None:
        """Add rows."""
        self.rows.add(count, entries, lower, upper)
        empty = sparse.csr_matrix((count, self.instance.products.count))
        self.Q.append(empty if Q is None else Q)

    def finish(self) -> DisjunctiveForm:
        """Return the extended instance."""
        n, K = self.instance.size, self.instance.products.count
        without_disjunctions = replace(
            self.instance, choices=(), implications=create_no_implications(n, K)
        )
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
        return DisjunctiveForm(
            extend_instance(without_disjunctions, extension), n, relaxation=False, binaries=groups
        )


def _list_triplets(rows: sparse.csr_matrix) -> tuple[Array, Array, Array]:
    """Return rows, columns and values of the entries."""
    entry = sparse.coo_matrix(rows)
    return entry.row, entry.col, entry.data


def _add_choice_big_m(
    build: _FormBuilder, choice: Choice, group: IntArray, box: VariableBox
) -> None:
    """Add the big-M rows of a choice.

    a y <= b holds where alternative r does, and its maximum where s does: a y <= b z_r + sum_s M_s
    z_s, each M_s from the vertices of s or from the box.
    """
    for r, polytope in enumerate(choice.alternatives):
        for a, low, high in (
            (polytope.A, np.full(len(polytope.b), -np.inf), polytope.b),
            (polytope.C, polytope.c, polytope.c),
        ):
            rows = sparse.csr_matrix(sparse.csr_matrix(a) @ choice.E)
            reach = box.interval(rows)
            offset = a @ choice.e
            minimum = np.tile((reach.lower + offset)[:, None], len(group))
            maximum = np.tile((reach.upper + offset)[:, None], len(group))
            for s, alternative in enumerate(choice.alternatives):
                if alternative.vertices is not None:
                    value = a @ alternative.vertices.T
                    minimum[:, s] = np.maximum(minimum[:, s], value.min(axis=1))
                    maximum[:, s] = np.minimum(maximum[:, s], value.max(axis=1))
            minimum[:, r], maximum[:, r] = (
                np.maximum(low, minimum[:, r]),
                np.minimum(high, maximum[:, r]),
            )
            name = f"{choice.name}, alternative {polytope.name}"
            for bound, sign, stated in ((maximum, 1.0, high), (minimum, -1.0, low)):
                stated_rows = np.flatnonzero(np.isfinite(stated))
                infinite = stated_rows[~np.isfinite(bound[stated_rows]).all(axis=1)]
                if len(infinite):
                    raise UsageError(
                        f"{name}: row {infinite[0]} is not bounded, so it has no big-M; "
                        "give its variables bounds"
                    )
                count = len(stated_rows)
                i, j, value = _list_triplets(rows[stated_rows])
                spread = (np.arange(count)[:, None], group, -sign * bound[stated_rows])
                build.add_rows(
                    count, [(i, j, sign * value), spread], -np.inf, -sign * offset[stated_rows]
                )


def _add_implication_big_m(
    build: _FormBuilder, instance: Instance, box: VariableBox, which: IntArray
) -> None:
    """Add rows for z = v implies row <= u: row + (M - u) [z = v] <= M with the row's maximum M."""
    implications = instance.implications
    rows, Q = implications.A[which], implications.Q[which]
    reach = box.interval(rows, Q)
    binary, value = implications.binary[which], implications.value[which]
    for bound, extreme, sign in (
        (implications.upper[which], reach.upper, 1.0),
        (implications.lower[which], reach.lower, -1.0),
    ):
        # Rows that hold over the whole box need no binary
        needed = np.flatnonzero(np.isfinite(bound) & (sign * extreme > sign * bound))
        infinite = needed[~np.isfinite(extreme[needed])]
        if len(infinite):
            raise UsageError(
                f"{instance.name}: implication row {which[infinite[0]]} (on variable "
                f"{binary[infinite[0]]}) is not bounded, so it has no big-M; "
                "give its variables bounds"
            )
        count, row_index = len(needed), np.arange(len(needed))
        slack = sign * (extreme[needed] - bound[needed])
        is_one = value[needed]
        i, j, data = _list_triplets(rows[needed])
        build.add_rows(
            count,
            [(i, j, sign * data), (row_index, binary[needed], np.where(is_one, slack, -slack))],
            -np.inf,
            np.where(is_one, sign * extreme[needed], sign * bound[needed]),
            sign * Q[needed],
        )


def _add_choice_hull(
    build: _FormBuilder, choice: Choice, group: IntArray, box: VariableBox
) -> None:
    """Add the hull of a choice with a copy y_r of its point for each alternative.

    y = sum_r y_r, A_r y_r <= b_r z_r, C_r y_r = c_r z_r, y_r within the box times z_r.
    """
    d = choice.E.shape[0]
    reach = box.interval(choice.E)
    box_range = (reach.lower + choice.e, reach.upper + choice.e)
    copies = []
    for polytope, z in zip(choice.alternatives, group, strict=True):
        low, high = box_range
        if polytope.vertices is not None:
            low = np.maximum(low, polytope.vertices.min(axis=0))
            high = np.minimum(high, polytope.vertices.max(axis=0))
        if not (np.isfinite(low) & np.isfinite(high)).all():
            raise UsageError(
                f"{choice.name}, alternative {polytope.name}: its point is not bounded, "
                "which the convex hull needs; give its variables bounds"
            )
        copy = build.add_variables(np.minimum(low, 0.0), np.maximum(high, 0.0))
        _add_scaled_rows(build, sparse.csr_matrix(polytope.A), copy, z, None, polytope.b)
        _add_scaled_rows(build, sparse.csr_matrix(polytope.C), copy, z, polytope.c, polytope.c)
        _add_scaled_rows(build, sparse.identity(d, format="csr"), copy, z, low, high)
        copies.append((np.arange(d), copy, -1.0))
    build.add_rows(d, [_list_triplets(choice.E), *copies], -choice.e, -choice.e)


def _add_implication_hull(
    build: _FormBuilder, instance: Instance, box: VariableBox, binary: int, rows: IntArray
) -> None:
    """Add the hull of an implication with copies x = u + v.

    u satisfies the rows of z = 1 and the box times z, v those of z = 0 and the box times 1 - z.
    """
    implications = instance.implications
    variables = np.unique(implications.A[rows].indices)
    low, high = box.lower[variables], box.upper[variables]
    if not (np.isfinite(low) & np.isfinite(high)).all():
        raise UsageError(
            f"{instance.name}: implication row {rows[0]} (on variable {binary}) has a variable "
            "without bounds, which the convex hull needs"
        )
    d = len(variables)
    copies = []
    for value in (True, False):
        copy = build.add_variables(np.minimum(low, 0.0), np.maximum(high, 0.0))
        active_rows = rows[implications.value[rows] == value]
        A = sparse.csr_matrix(implications.A[active_rows][:, variables])
        lower, upper = implications.lower[active_rows], implications.upper[active_rows]
        for a, row_lower, row_upper in (
            (A, lower, upper),
            (sparse.identity(d, format="csr"), low, high),
        ):
            _add_scaled_rows(build, a, copy, binary, row_lower, row_upper, complement=not value)
        copies.append((np.arange(d), copy, -1.0))
    build.add_rows(d, [(np.arange(d), variables, 1.0), *copies], 0.0, 0.0)


def _add_scaled_rows(
    build: _FormBuilder,
    A: sparse.csr_matrix,
    copy: IntArray,
    z: int,
    lower: Array | None,
    upper: Array | None,
    *,
    complement: bool = False,
) -> None:
    """Add lower z <= A copy <= upper z, with 1 - z instead of z for the complement."""
    for bound, sign in ((upper, 1.0), (lower, -1.0)):
        if bound is None:
            continue
        finite_rows = np.flatnonzero(np.isfinite(bound))
        if len(finite_rows) == 0:
            continue
        i, j, value = _list_triplets(A[finite_rows])
        right_side = sign * bound[finite_rows]
        factor = right_side if complement else -right_side
        limit = right_side if complement else np.zeros(len(finite_rows))
        entries = [(i, copy[j], sign * value), (np.arange(len(finite_rows)), z, factor)]
        build.add_rows(len(finite_rows), entries, -np.inf, limit)
