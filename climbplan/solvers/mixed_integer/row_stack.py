"""All rows of a mixed-integer program over w, and when nodes have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.problem_data import ALWAYS, DECIDED, UNDECIDED
from climbplan.solvers.mixed_integer.product_data import ProductFactors
from climbplan.solvers.mixed_integer.row_keys import KeySpace
from climbplan.solvers.mixed_integer.switch_pairs import compute_row_intervals, pair_indicator_rows

_OUTSIDE = 1e-7  # violation over the whole box at which a row proves infeasibility


@dataclass(frozen=True)
class Coordinates:
    """Map x = X w + start of all variables but switches, and the box after bound propagation."""

    X: Array  # (size, k)
    start: Array  # (size,)
    lower: Array  # (size,)
    upper: Array
    switch: BoolArray  # (size,)
    equal: BoolArray  # (m,) plain rows that are eliminated
    columns: IntArray  # variables that are no switches
    independent: IntArray  # (k,) indices of w in x
    inside: IntArray  # (k,) indices of w among the columns


@dataclass(frozen=True)
class NodeRows:
    """Rows low <= R w <= high; the value of the stated row is R w + base."""

    R: Array  # (m, k)
    base: Array  # (m,)
    low: Array
    high: Array
    key: IntArray
    activation: NDArray[np.int8]  # ALWAYS, DECIDED, UNDECIDED
    entity: IntArray  # integer that activates the row, -1 for none
    value: IntArray  # value of the integer at which a DECIDED row is active
    inverse_big_m: Array  # 1 / M of DECIDED rows
    value_row: IntArray  # (E,) row whose value is that of the integer, -1 for a switch
    indicator_start: IntArray  # (E + 1,) begin of each integer's rows in `indicator_rows`
    indicator_rows: IntArray


@dataclass
class _RowCollector:
    """Rows in the order in which they are appended."""

    R: list[Array]
    base: list[Array]
    low: list[Array]
    high: list[Array]
    key: list[IntArray]
    activation: list[IntArray]
    entity: list[IntArray]
    value: list[IntArray]
    inverse_big_m: list[Array]

    @classmethod
    def empty(cls) -> _RowCollector:
        """Return a collector without rows."""
        return cls([], [], [], [], [], [], [], [], [])

    def append(
        self,
        R: Array,
        base: Array,
        low: Array,
        high: Array,
        *,
        key: IntArray,
        activation: int,
        entity: IntArray | None = None,
        value: IntArray | None = None,
        inverse_big_m: Array | None = None,
    ) -> None:
        """Append rows; without an entity they are always active."""
        m = len(R)
        self.R.append(R)
        self.base.append(base)
        self.low.append(low)
        self.high.append(high)
        self.key.append(key)
        self.activation.append(np.full(m, activation))
        self.entity.append(np.full(m, -1) if entity is None else entity)
        self.value.append(np.zeros(m, np.int64) if value is None else value)
        self.inverse_big_m.append(np.zeros(m) if inverse_big_m is None else inverse_big_m)


def stack_rows(form: IndicatorForm, space: Coordinates) -> NodeRows | None:
    """Stack bounds, plain rows, indicator rows, and their aggregations for undecided nodes.

    Returns:
        None if a row cannot hold within the box.
    """
    keys = KeySpace(form.size, len(form.A.indptr) - 1, len(form.indicator))
    pile = _RowCollector.empty()
    _append_bounds(pile, form, space)
    _append_plain(pile, form, space, keys)
    num_plain = sum(len(rows) for rows in pile.R)
    entities = np.flatnonzero(form.integer)
    entity_of = np.full(form.size, -1)
    entity_of[entities] = np.arange(len(entities))
    C_w, C_start = form.C @ space.X, form.C @ space.start
    excess_low, excess_high = _compute_violations(form, space)
    scale = np.maximum(*(np.where(np.isfinite(e), e, 0.0) for e in (excess_low, excess_high)))
    pile.append(
        C_w, C_start, form.indicator_lower, form.indicator_upper,
        key=keys.first_conditional + np.arange(len(form.indicator)), activation=DECIDED,
        entity=entity_of[form.indicator], value=form.value,
        inverse_big_m=1.0 / np.maximum(scale, 1e-6),
    )  # fmt: skip
    order = np.argsort(entity_of[form.indicator], kind="stable")
    first = np.searchsorted(entity_of[form.indicator][order], np.arange(len(entities) + 1))
    is_undecided = space.lower[form.indicator] < space.upper[form.indicator]
    a, sign_a, c, sign_c, big_m_a, big_m_c, switch_of_pair = pair_indicator_rows(
        entities, space.switch, first, order, form.value, is_undecided, excess_low, excess_high,
        form.indicator_lower, form.indicator_upper,
    )  # fmt: skip
    if len(a):
        weight_a, weight_c = sign_a / big_m_a, sign_c / big_m_c
        right_side_a = np.where(sign_a > 0, form.indicator_upper[a], form.indicator_lower[a])
        right_side_c = np.where(sign_c > 0, form.indicator_upper[c], form.indicator_lower[c])
        pile.append(
            weight_a[:, None] * C_w[a] + weight_c[:, None] * C_w[c],
            weight_a * C_start[a] + weight_c * C_start[c],
            np.full(len(a), -np.inf), 1.0 + weight_a * right_side_a + weight_c * right_side_c,
            entity=switch_of_pair, activation=UNDECIDED, key=keys.encode_pair(a, sign_a, c, sign_c),
        )  # fmt: skip
    for sign, bound, excess in (
        (1.0, form.indicator_upper, excess_high), (-1.0, form.indicator_lower, excess_low)
    ):  # fmt: skip
        selected = np.flatnonzero(
            ~space.switch[form.indicator]
            & is_undecided
            & np.isfinite(bound)
            & np.isfinite(excess)
            & (excess > 0)
        )
        # a x + M z <= b + M where z = 1 has the row, a x - M z <= b where z = 0 has
        slope = np.where(form.value[selected] == 1, excess[selected], -excess[selected])
        binary = form.indicator[selected]
        pile.append(
            sign * C_w[selected] + slope[:, None] * space.X[binary],
            sign * C_start[selected] + slope * space.start[binary],
            np.full(len(selected), -np.inf),
            sign * bound[selected] + np.where(form.value[selected] == 1, excess[selected], 0.0),
            key=keys.encode_big_m(selected, sign), activation=UNDECIDED, entity=entity_of[binary],
        )  # fmt: skip
    return _drop_redundant(form, space, pile, num_plain, order, first)


def append_products(
    stack: NodeRows, form: IndicatorForm, factors: ProductFactors, space: Coordinates
) -> NodeRows:
    """Append the values of factors and products, and empty rows for the envelopes."""
    F, K = len(factors.space), factors.products.count
    variables = np.concatenate([factors.space, factors.places])
    m = len(variables) + 4 * K
    k, num_stated = space.X.shape[1], len(stack.R)
    no_entity = np.full(m, -1)
    keys = KeySpace(form.size, len(form.row_lower), len(form.indicator), int(factors.places[0]))
    open_ends = np.full(4 * K, np.inf)
    base = np.concatenate([space.start[variables], np.zeros(4 * K)])
    low, high = (
        space.lower[variables] - space.start[variables],
        space.upper[variables] - space.start[variables],
    )
    return NodeRows(
        R=np.vstack([stack.R, space.X[variables], np.zeros((4 * K, k))]),
        base=np.concatenate([stack.base, base]),
        low=np.concatenate([stack.low, low, -open_ends]),
        high=np.concatenate([stack.high, high, open_ends]),
        key=np.concatenate([stack.key, keys.encode_ranges(variables), keys.encode_envelopes(K)]),
        activation=np.concatenate([stack.activation, np.full(m, ALWAYS, np.int8)]),
        entity=np.concatenate([stack.entity, no_entity]),
        value=np.concatenate([stack.value, np.zeros(m, np.int64)]),
        inverse_big_m=np.concatenate([stack.inverse_big_m, np.zeros(m)]),
        value_row=np.concatenate([stack.value_row, num_stated + np.arange(F)]),
        indicator_start=np.concatenate(
            [stack.indicator_start, np.full(F, stack.indicator_start[-1])]
        ),
        indicator_rows=stack.indicator_rows,
    )


def _compute_violations(form: IndicatorForm, space: Coordinates) -> tuple[Array, Array]:
    """Return the largest violation of the lower and upper side of each indicator row."""
    C = form.C
    minimum, maximum = compute_row_intervals(C.indptr, C.indices, C.data, space.lower, space.upper)
    with np.errstate(invalid="ignore"):  # infinite minus infinite: a missing side
        high = np.nan_to_num(np.maximum(maximum - form.indicator_upper, 0.0), posinf=np.inf)
        low = np.nan_to_num(np.maximum(form.indicator_lower - minimum, 0.0), posinf=np.inf)
    return low, high


def _append_bounds(rows: _RowCollector, form: IndicatorForm, space: Coordinates) -> None:
    """Append bounds of columns: propagated ones for w and integers, stated ones for others."""
    columns, inside = space.columns, space.inside
    is_entity = form.integer[columns]
    low = np.where(is_entity, space.lower[columns], form.lower[columns])
    high = np.where(is_entity, space.upper[columns], form.upper[columns])
    low[inside], high[inside] = space.lower[space.independent], space.upper[space.independent]
    rows.append(space.X[columns], space.start[columns], low, high, key=columns, activation=ALWAYS)


def _append_plain(
    rows: _RowCollector, form: IndicatorForm, space: Coordinates, keys: KeySpace
) -> None:
    """Append the rows that all nodes have, except equations."""
    unequal = np.flatnonzero(~space.equal)
    A = form.A.toarray()[unequal]
    rows.append(
        A @ space.X, form.A[unequal] @ space.start,
        form.row_lower[unequal], form.row_upper[unequal],
        key=keys.first_plain + unequal, activation=ALWAYS,
    )  # fmt: skip


def _drop_redundant(
    form: IndicatorForm,
    space: Coordinates,
    rows: _RowCollector,
    num_plain: int,
    order: IntArray,
    first: IntArray,
) -> NodeRows | None:
    """Drop rows that hold over the whole box, except indicator rows and rows of integers.

    Returns:
        None if a row cannot hold within the box.
    """
    R, base = np.vstack(rows.R), np.concatenate(rows.base)
    low, high = np.concatenate(rows.low) - base, np.concatenate(rows.high) - base
    activation = np.concatenate(rows.activation).astype(np.int8)
    minimum, maximum = _compute_extremes(R, space)
    # Each side has its own rounding error: an open variable makes that of one side huge
    below, above = (1e-10 * np.maximum(1.0, np.abs(extreme)) for extreme in (minimum, maximum))
    is_violated = (minimum > high + _OUTSIDE + below) | (maximum < low - _OUTSIDE - above)
    if (is_violated & (activation == ALWAYS)).any():
        return None
    is_kept = ~((minimum >= low - below) & (maximum <= high + above))
    is_kept[space.inside] = True
    is_kept[: len(space.columns)] |= form.integer[space.columns]
    is_kept[num_plain : num_plain + len(form.indicator)] = True
    is_kept &= np.isfinite(low) | np.isfinite(high)
    # An empty indicator row that fails excludes a value, which propagation has applied
    is_kept &= np.abs(R).max(axis=1, initial=0.0) > 1e-12
    keep = np.flatnonzero(is_kept)
    new_index = np.full(len(R), -1)
    new_index[keep] = np.arange(len(keep))
    indicator_rows = new_index[num_plain + order]
    entities = np.flatnonzero(form.integer)
    of_column = np.full(form.size, -1)
    of_column[space.columns] = np.arange(len(space.columns))
    with_column = ~space.switch[entities]
    value_row = np.full(len(entities), -1)
    value_row[with_column] = new_index[of_column[entities[with_column]]]
    return NodeRows(
        R=R[keep],
        base=base[keep],
        low=low[keep],
        high=high[keep],
        key=np.concatenate(rows.key)[keep],
        activation=activation[keep],
        entity=np.concatenate(rows.entity)[keep],
        value=np.concatenate(rows.value)[keep],
        inverse_big_m=np.concatenate(rows.inverse_big_m)[keep],
        value_row=value_row,
        indicator_start=np.concatenate([[0], np.cumsum(indicator_rows >= 0)])[first],
        indicator_rows=indicator_rows[indicator_rows >= 0],
    )


def _compute_extremes(R: Array, space: Coordinates) -> tuple[Array, Array]:
    """Return the minimum and the maximum of every row over the box."""
    low, high = space.lower[space.independent], space.upper[space.independent]
    low, high = np.where(np.isfinite(low), low, -1e30), np.where(np.isfinite(high), high, 1e30)
    positive, negative = np.maximum(R, 0.0), np.minimum(R, 0.0)
    return positive @ low + negative @ high, positive @ high + negative @ low
