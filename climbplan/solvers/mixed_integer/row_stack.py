"""All rows of a mixed-integer program over w, and when a node has each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.keys import KeySpace
from climbplan.solvers.mixed_integer.numbers import ALWAYS, DECIDED, UNDECIDED
from climbplan.solvers.mixed_integer.pairs import paired, row_intervals
from climbplan.solvers.mixed_integer.spatial_rows import Factors

_OUTSIDE = 1e-7  # by which a row must fail all over the box to prove that nothing is feasible


@dataclass(frozen=True)
class Coordinates:
    """x = X w + start for all variables but switches, and the box that bounds and rows leave."""

    X: Array  # (size, k)
    start: Array  # (size,)
    lower: Array  # (size,)
    upper: Array
    switch: BoolArray  # (size,)
    equal: BoolArray  # (m,) plain rows that are eliminated
    columns: IntArray  # variables that are no switches
    independent: IntArray  # (k,) places of w in x
    inside: IntArray  # (k,) and among the columns


@dataclass(frozen=True)
class RowStack:
    """low <= R w <= high, where the row's own value is R w + base."""

    R: Array  # (m, k)
    base: Array  # (m,)
    low: Array
    high: Array
    key: IntArray
    when: NDArray[np.int8]  # ALWAYS, DECIDED, UNDECIDED
    entity: IntArray  # integer that decides, -1
    value: IntArray  # of a decided integer that has the row
    share: Array  # of DECIDED rows: 1 / M
    column: IntArray  # (E,) row that holds an integer's value, -1 for a switch
    first: IntArray  # (E + 1,) where in `rows_of` the conditional rows of an integer stand
    rows_of: IntArray


@dataclass
class _Pile:
    """Rows in the order in which they are put down."""

    R: list[Array]
    base: list[Array]
    low: list[Array]
    high: list[Array]
    key: list[IntArray]
    when: list[IntArray]
    entity: list[IntArray]
    value: list[IntArray]
    share: list[Array]

    @classmethod
    def empty(cls) -> _Pile:
        """Nothing yet."""
        return cls([], [], [], [], [], [], [], [], [])

    def put(
        self,
        R: Array,
        base: Array,
        low: Array,
        high: Array,
        key: IntArray,
        when: int,
        entity: IntArray | None = None,
        value: IntArray | None = None,
        share: Array | None = None,
    ) -> None:
        """Put rows down; what decides them is nothing if left out."""
        m = len(R)
        self.R.append(R)
        self.base.append(base)
        self.low.append(low)
        self.high.append(high)
        self.key.append(key)
        self.when.append(np.full(m, when))
        self.entity.append(np.full(m, -1) if entity is None else entity)
        self.value.append(np.zeros(m, np.int64) if value is None else value)
        self.share.append(np.zeros(m) if share is None else share)


def row_stack(form: Conditional, space: Coordinates) -> RowStack | None:
    """Bounds, plain rows, conditional rows, and what undecided nodes have of these.

    None if a row cannot hold within the box.
    """
    keys = KeySpace(form.size, len(form.A.indptr) - 1, len(form.when))
    pile = _Pile.empty()
    _bounds(pile, form, space)
    _plain(pile, form, space, keys)
    plain = sum(len(rows) for rows in pile.R)
    entities = np.flatnonzero(form.integer)
    number = np.full(form.size, -1)
    number[entities] = np.arange(len(entities))
    C_w, C_start = form.C @ space.X, form.C @ space.start
    excess_low, excess_high = _excess(form, space)
    scale = np.maximum(*(np.where(np.isfinite(e), e, 0.0) for e in (excess_low, excess_high)))
    pile.put(
        C_w, C_start, form.when_lower, form.when_upper,
        keys.conditional + np.arange(len(form.when)), DECIDED, number[form.when], form.value,
        1.0 / np.maximum(scale, 1e-6),
    )  # fmt: skip
    order = np.argsort(number[form.when], kind="stable")
    first = np.searchsorted(number[form.when][order], np.arange(len(entities) + 1))
    free = space.lower[form.when] < space.upper[form.when]
    a, sign_a, c, sign_c, most_a, most_c, of = paired(
        entities, space.switch, first, order, form.value, free, excess_low, excess_high,
        form.when_lower, form.when_upper,
    )  # fmt: skip
    if len(a):
        weight_a, weight_c = sign_a / most_a, sign_c / most_c
        edge_a = np.where(sign_a > 0, form.when_upper[a], form.when_lower[a])
        edge_c = np.where(sign_c > 0, form.when_upper[c], form.when_lower[c])
        pile.put(
            weight_a[:, None] * C_w[a] + weight_c[:, None] * C_w[c],
            weight_a * C_start[a] + weight_c * C_start[c],
            np.full(len(a), -np.inf), 1.0 + weight_a * edge_a + weight_c * edge_c,
            keys.pair(a, sign_a, c, sign_c), UNDECIDED, of,
        )  # fmt: skip
    for sign, bound, excess in (
        (1.0, form.when_upper, excess_high), (-1.0, form.when_lower, excess_low)
    ):  # fmt: skip
        here = np.flatnonzero(
            ~space.switch[form.when]
            & free
            & np.isfinite(bound)
            & np.isfinite(excess)
            & (excess > 0)
        )
        # a x + M z <= b + M where z = 1 has the row, a x - M z <= b where z = 0 has
        slope = np.where(form.value[here] == 1, excess[here], -excess[here])
        z = form.when[here]
        pile.put(
            sign * C_w[here] + slope[:, None] * space.X[z],
            sign * C_start[here] + slope * space.start[z],
            np.full(len(here), -np.inf),
            sign * bound[here] + np.where(form.value[here] == 1, excess[here], 0.0),
            keys.big_m(here, sign), UNDECIDED, number[z],
        )  # fmt: skip
    return _kept(form, space, pile, plain, order, first)


def with_products(
    stack: RowStack, form: Conditional, factors: Factors, space: Coordinates
) -> RowStack:
    """Behind all others the values of factors and products, and room for the envelopes' rows."""
    F, K = len(factors.space), factors.products.count
    at = np.concatenate([factors.space, factors.places])
    m = len(at) + 4 * K
    k, stated = space.X.shape[1], len(stack.R)
    none = np.full(m, -1)
    keys = KeySpace(form.size, len(form.row_lower), len(form.when), int(factors.places[0]))
    open_ends = np.full(4 * K, np.inf)
    base = np.concatenate([space.start[at], np.zeros(4 * K)])
    low, high = space.lower[at] - space.start[at], space.upper[at] - space.start[at]
    return RowStack(
        R=np.vstack([stack.R, space.X[at], np.zeros((4 * K, k))]),
        base=np.concatenate([stack.base, base]),
        low=np.concatenate([stack.low, low, -open_ends]),
        high=np.concatenate([stack.high, high, open_ends]),
        key=np.concatenate([stack.key, keys.ranges(at), keys.envelopes(K)]),
        when=np.concatenate([stack.when, np.full(m, ALWAYS, np.int8)]),
        entity=np.concatenate([stack.entity, none]),
        value=np.concatenate([stack.value, np.zeros(m, np.int64)]),
        share=np.concatenate([stack.share, np.zeros(m)]),
        column=np.concatenate([stack.column, stated + np.arange(F)]),
        first=np.concatenate([stack.first, np.full(F, stack.first[-1])]),
        rows_of=stack.rows_of,
    )


def _excess(form: Conditional, space: Coordinates) -> tuple[Array, Array]:
    """By how much the lower and the upper side of each conditional row can fail in the box."""
    C = form.C
    least, most = row_intervals(C.indptr, C.indices, C.data, space.lower, space.upper)
    with np.errstate(invalid="ignore"):  # infinite less infinite: there is no such side
        high = np.nan_to_num(np.maximum(most - form.when_upper, 0.0), posinf=np.inf)
        low = np.nan_to_num(np.maximum(form.when_lower - least, 0.0), posinf=np.inf)
    return low, high


def _bounds(pile: _Pile, form: Conditional, space: Coordinates) -> None:
    """Bounds of all columns: what was propagated for w and integers, the stated ones for others."""
    columns, inside = space.columns, space.inside
    is_entity = form.integer[columns]
    low = np.where(is_entity, space.lower[columns], form.lower[columns])
    high = np.where(is_entity, space.upper[columns], form.upper[columns])
    low[inside], high[inside] = space.lower[space.independent], space.upper[space.independent]
    pile.put(space.X[columns], space.start[columns], low, high, columns, ALWAYS)


def _plain(pile: _Pile, form: Conditional, space: Coordinates, keys: KeySpace) -> None:
    """Rows that all nodes have, but for equations."""
    unequal = np.flatnonzero(~space.equal)
    A = form.A.toarray()[unequal]
    pile.put(
        A @ space.X, form.A[unequal] @ space.start,
        form.row_lower[unequal], form.row_upper[unequal],
        keys.plain + unequal, ALWAYS,
    )  # fmt: skip


def _kept(
    form: Conditional,
    space: Coordinates,
    pile: _Pile,
    plain: int,
    order: IntArray,
    first: IntArray,
) -> RowStack | None:
    """Without what holds all over the box, but for conditional rows and integers."""
    R, base = np.vstack(pile.R), np.concatenate(pile.base)
    low, high = np.concatenate(pile.low) - base, np.concatenate(pile.high) - base
    when = np.concatenate(pile.when).astype(np.int8)
    least, most = _extremes(R, space)
    size = 1e-10 * np.maximum(1.0, np.maximum(np.abs(least), np.abs(most)))
    fails = (least > high + _OUTSIDE + size) | (most < low - _OUTSIDE - size)
    if (fails & (when == ALWAYS)).any():
        return None
    kept = ~((least >= low - size) & (most <= high + size))
    kept[space.inside] = True
    kept[: len(space.columns)] |= form.integer[space.columns]
    kept[plain : plain + len(form.when)] = True
    kept &= np.isfinite(low) | np.isfinite(high)
    # An empty conditional row that fails excludes a value, which propagation has seen
    kept &= np.abs(R).max(axis=1, initial=0.0) > 1e-12
    keep = np.flatnonzero(kept)
    place = np.full(len(R), -1)
    place[keep] = np.arange(len(keep))
    rows_of = place[plain + order]
    entities = np.flatnonzero(form.integer)
    of_column = np.full(form.size, -1)
    of_column[space.columns] = np.arange(len(space.columns))
    with_column = ~space.switch[entities]
    column = np.full(len(entities), -1)
    column[with_column] = place[of_column[entities[with_column]]]
    return RowStack(
        R=R[keep],
        base=base[keep],
        low=low[keep],
        high=high[keep],
        key=np.concatenate(pile.key)[keep],
        when=when[keep],
        entity=np.concatenate(pile.entity)[keep],
        value=np.concatenate(pile.value)[keep],
        share=np.concatenate(pile.share)[keep],
        column=column,
        first=np.concatenate([[0], np.cumsum(rows_of >= 0)])[first],
        rows_of=rows_of[rows_of >= 0],
    )


def _extremes(R: Array, space: Coordinates) -> tuple[Array, Array]:
    """Least and largest value of every row over the box."""
    low, high = space.lower[space.independent], space.upper[space.independent]
    low, high = np.where(np.isfinite(low), low, -1e30), np.where(np.isfinite(high), high, 1e30)
    positive, negative = np.maximum(R, 0.0), np.minimum(R, 0.0)
    return positive @ low + negative @ high, positive @ high + negative @ low
