"""Which choice to branch on, and how to divide its alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.program.polytope import Array
from climbplan.solvers.choice_table import Mask
from climbplan.solvers.dual_gains import RowRates
from climbplan.solvers.normal_form import ChoiceGroup, Flags, NormalForm
from climbplan.solvers.result import Indices

_LEAST_GAIN = 1e-9  # relative: a child without gain must not hide its sibling's


@dataclass(frozen=True)
class Split:
    """Children of a branching decision."""

    choice: int
    children: tuple[Mask, ...]
    gains: Array  # (children,) sure rise of the bound in each


def table_values(form: NormalForm, group: ChoiceGroup, value: Array) -> Array:
    """Where each choice of a group stands along its directions, (G, D).

    value: (P,) choice rows at z.
    """
    here = group.rows - form.choice_rows.start
    return np.asarray(value[here] + form.offset[group.rows])


def violations(form: NormalForm, value: Array, allowed: Flags) -> Array:
    """Violation of every allowed alternative (C, R), infinite for those not allowed."""
    out = np.full(allowed.shape, np.inf)
    for group in form.groups:
        y = table_values(form, group, value)[:, None]
        table = group.table
        off = np.maximum(y - table.own_upper, table.own_lower - y).max(axis=-1, initial=0.0)
        out[group.choices[:, None], np.arange(table.count)] = off
    out[~allowed] = np.inf
    return out


def single_gains(form: NormalForm, value: Array, rates: RowRates, groups: Flags) -> Array:
    """Sure rise of the bound if a choice takes an alternative (C, R)."""
    out = np.zeros(form.allowed.shape)
    for group in form.groups:
        here = groups[group.choices]
        if not here.any():
            continue
        rows = group.rows[here] - form.choice_rows.start
        y = value[rows] + form.offset[group.rows[here]]
        table = group.table
        gain = rates.take(rows[:, None]).gain(y[:, None], table.own_lower, table.own_upper)
        out[group.choices[here][:, None], np.arange(table.count)] = gain
    return out


def best_split(
    form: NormalForm, value: Array, rates: RowRates, allowed: Flags, candidates: Indices
) -> Split:
    """The division whose children gain most, by the product of their gains."""
    alike: dict[tuple[int, Mask], list[int]] = {}
    for c in candidates:
        table = form.tables[c]
        alike.setdefault((id(table), table.mask(allowed[c])), []).append(int(c))
    best: Split | None = None
    best_score = -np.inf
    for (_, mask), choices in alike.items():
        splits = form.tables[choices[0]].splits(mask)
        width = np.arange(len(form.tables[choices[0]].directions))
        rows = form.start[choices][:, None] + width - form.choice_rows.start  # (G, D)
        y = value[rows] + form.offset[rows + form.choice_rows.start]
        gains = rates.take(rows[:, None]).gain(y[:, None], splits.lower, splits.upper)  # (G, K)
        floor = _LEAST_GAIN + 1e-3 * gains.max(axis=1, keepdims=True, initial=0.0)
        sizes = np.diff([*splits.first, gains.shape[1]])
        score = np.add.reduceat(np.log(np.maximum(gains, floor)), splits.first, axis=1) / sizes
        g, way = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[g, way] > best_score:
            best_score = float(score[g, way])
            here = slice(int(splits.first[way]), int(splits.first[way] + sizes[way]))
            best = Split(choices[int(g)], splits.children[here], gains[g, here])
    assert best is not None
    return best
