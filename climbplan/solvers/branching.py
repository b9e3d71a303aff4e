"""Which choice to branch on, and how to divide its alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.program.polytope import Array
from climbplan.solvers.choice_table import Mask, Splits
from climbplan.solvers.dual_gains import RowRates
from climbplan.solvers.normal_form import ChoiceGroup, Flags, NormalForm
from climbplan.solvers.result import Indices

_FLOOR, _CAP = 1e-3, 10.0  # gains count between these shares of the best two-sided gain
_SMALLEST = 1e-12


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
    """The division whose children gain most, by the product of their gains.

    Gains far beyond the best that any division reaches in all its children do not count: a child
    that is out of question anyway must not hide that its sibling gains nothing.
    """
    alike: dict[tuple[int, Mask], list[int]] = {}
    for c in candidates:
        table = form.tables[c]
        alike.setdefault((id(table), table.mask(allowed[c])), []).append(int(c))
    found: list[tuple[list[int], Splits, Array]] = []
    base = form.choice_rows.start
    for (_, mask), choices in alike.items():
        table = form.tables[choices[0]]
        splits = table.splits(mask)
        rows = form.start[choices][:, None] + np.arange(len(table.directions))  # (G, D)
        y = value[rows - base] + form.offset[rows]
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
