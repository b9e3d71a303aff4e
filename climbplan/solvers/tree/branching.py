"""Which choice to branch on, and how to divide its alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.tree.choice_table import Mask, Splits
from climbplan.solvers.tree.dual_gains import RowRates
from climbplan.solvers.tree.normal_form import ChoiceGroup, Masks, NormalForm, own_violations
from climbplan.solvers.tree.sectors import sector_splits

_FLOOR, _CAP = 1e-3, 10.0  # gains count between these shares of the best two-sided gain
_SMALLEST = 1e-12
_WIDE = 8  # choices among many alternatives of which divisions are looked at


@dataclass(frozen=True)
class Split:
    """Children of a branching decision."""

    choice: int
    children: tuple[Mask, ...]
    gains: Array  # (children,) sure rise of the bound in each


def violations(
    form: NormalForm,
    z: Array,
    value: Array,
    allowed: BoolArray,
    groups: Sequence[ChoiceGroup] | None = None,
) -> Array:
    """Violation of every allowed alternative (C, R), infinite for those not allowed.

    value: (P,) choice rows at z. groups: those asked for, all if left out.
    """
    out = np.full(allowed.shape, np.inf)
    for group in form.groups if groups is None else groups:
        table = group.table
        if table.complete:
            y = (value[group.rows - form.choice_rows.start] + form.offset[group.rows])[:, None]
            off = np.maximum(y - table.own_upper, table.own_lower - y).max(axis=-1, initial=0.0)
        else:
            at = group.points.ravel()
            points = (form.points.E[at] @ z + form.points.e[at]).reshape(group.points.shape)
            off = own_violations(table, points)
        out[group.choices[:, None], np.arange(table.count)] = off
    out[~allowed] = np.inf
    return out


def single_gains(form: NormalForm, value: Array, rates: RowRates, groups: BoolArray) -> Array:
    """Sure rise of the bound if a choice takes an alternative (C, R)."""
    out = np.zeros(form.allowed.shape)
    for group in form.groups:
        here = groups[group.choices]
        if not here.any():
            continue
        rows = group.rows[here] - form.choice_rows.start
        y = value[rows] + form.offset[group.rows[here]]
        table = group.table
        lower, upper = table.own_lower, table.own_upper
        if not table.complete:
            lower, upper = table.lower, table.upper
        gain = rates.take(rows[:, None]).gain(y[:, None], lower, upper)
        out[group.choices[here][:, None], np.arange(table.count)] = gain
    return out


def best_split(
    form: NormalForm, value: Array, rates: RowRates, masks: Masks, candidates: IntArray
) -> Split:
    """The division whose children gain most, by the product of their gains.

    candidates: choices that may be divided, the most promising first: of those with many
    alternatives only the first few are looked at. Gains far beyond the best that any division
    reaches in all its children do not count: a child that is out of question anyway must not hide
    that its sibling gains nothing.
    """
    alike: dict[tuple[int, Mask], list[int]] = {}
    looked_at = 0
    for c in candidates:
        table = form.tables[c]
        looked_at += not table.listed
        if table.listed or looked_at <= _WIDE:
            # What is listed depends on the set alone, sectors also on where the point is.
            key = (id(table), masks[c]) if table.listed else (-1 - int(c), masks[c])
            alike.setdefault(key, []).append(int(c))
    found: list[tuple[list[int], Splits, Array]] = []
    base = form.choice_rows.start
    for (_, mask), choices in alike.items():
        table = form.tables[choices[0]]
        rows = form.start[choices][:, None] + np.arange(len(table.directions))  # (G, D)
        y = value[rows - base] + form.offset[rows]
        splits = table.splits(mask) if table.listed else sector_splits(table, mask, y[0])
        gains = rates.take(rows[:, None] - base).gain(y[:, None], splits.lower, splits.upper)
        found.append((choices, splits, gains))  # (G, children)
    least = [np.minimum.reduceat(g, s.first, axis=1).max(initial=0.0) for _, s, g in found]
    scale = max([*least, _SMALLEST])
    best: Split | None = None
    best_score = -np.inf
    for choices, splits, gains in found:
        sizes = np.diff([*splits.first, gains.shape[1]])
        logs = np.log(np.clip(gains, _FLOOR * scale, _CAP * scale))
        score = np.add.reduceat(logs, splits.first, axis=1) / sizes
        g, way = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[g, way] > best_score:
            best_score = float(score[g, way])
            here = slice(int(splits.first[way]), int(splits.first[way] + sizes[way]))
            best = Split(choices[int(g)], splits.children[here], gains[g, here])
    assert best is not None
    return best
