"""Select the choice to branch on, and how to divide its alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.tree.choice_table import Divisions, Mask
from climbplan.solvers.tree.dual_gains import DualSteps
from climbplan.solvers.tree.normal_form import (
    ChoiceGroup,
    Masks,
    NormalForm,
    compute_exact_violations,
)
from climbplan.solvers.tree.sectors import split_by_sectors

_FLOOR, _CAP = 1e-3, 10.0  # limits of gains, as fractions of the best two-sided gain
_SMALLEST = 1e-12
_WIDE = 8  # largest number of choices among many alternatives that are evaluated


@dataclass(frozen=True)
class BranchingChildren:
    """Children of a branching decision."""

    choice: int
    children: tuple[Mask, ...]
    gains: Array  # (children,) guaranteed rise of the bound in each


def compute_violations(
    form: NormalForm,
    z: Array,
    value: Array,
    allowed: BoolArray,
    groups: Sequence[ChoiceGroup] | None = None,
) -> Array:
    """Return the violation of every alternative (C, R), infinite for those not allowed.

    Args:
        form: The normal form.
        z: (k,) point.
        value: (P,) choice rows at z.
        allowed: (C, R) mask of alternatives.
        groups: Groups of choices to evaluate, all if missing.
    """
    violation = np.full(allowed.shape, np.inf)
    for group in form.groups if groups is None else groups:
        table = group.table
        if table.is_complete:
            y = (value[group.rows - form.choice_rows.start] + form.offset[group.rows])[:, None]
            group_violation = np.maximum(y - table.exact_upper, table.exact_lower - y).max(
                axis=-1, initial=0.0
            )
        else:
            index = group.points.ravel()
            points = (form.points.E[index] @ z + form.points.e[index]).reshape(group.points.shape)
            group_violation = compute_exact_violations(table, points)
        violation[group.choices[:, None], np.arange(table.count)] = group_violation
    violation[~allowed] = np.inf
    return violation


def compute_alternative_gains(
    form: NormalForm, value: Array, rates: DualSteps, groups: BoolArray
) -> Array:
    """Return the guaranteed rise of the bound if a choice takes an alternative (C, R)."""
    gains = np.zeros(form.allowed.shape)
    for group in form.groups:
        is_selected = groups[group.choices]
        if not is_selected.any():
            continue
        rows = group.rows[is_selected] - form.choice_rows.start
        y = value[rows] + form.offset[group.rows[is_selected]]
        table = group.table
        lower, upper = table.exact_lower, table.exact_upper
        if not table.is_complete:
            lower, upper = table.lower, table.upper
        gain = rates.select(rows[:, None]).compute_gain(y[:, None], lower, upper)
        gains[group.choices[is_selected][:, None], np.arange(table.count)] = gain
    return gains


def select_split(
    form: NormalForm, value: Array, rates: DualSteps, masks: Masks, candidates: IntArray
) -> BranchingChildren:
    """Select the division whose children gain most, by the product of their gains.

    Gains far beyond the largest gain that a division guarantees in all its children are capped: a
    child that is closed anyway must not hide that its sibling gains nothing.

    Args:
        form: The normal form.
        value: (P,) choice rows at the relaxation's solution.
        rates: Dual steps of the choice rows.
        masks: Allowed alternatives of every choice.
        candidates: Choices that may be divided, the most promising first; of those with many
            alternatives only the first few are evaluated.
    """
    equal_choices: dict[tuple[int, Mask], list[int]] = {}
    num_wide = 0
    for c in candidates:
        table = form.tables[c]
        num_wide += not table.has_listed_divisions
        if table.has_listed_divisions or num_wide <= _WIDE:
            # Listed divisions depend on the set alone, sectors also on the point.
            key = (id(table), masks[c]) if table.has_listed_divisions else (-1 - int(c), masks[c])
            equal_choices.setdefault(key, []).append(int(c))
    evaluated: list[tuple[list[int], Divisions, Array]] = []
    base = form.choice_rows.start
    for (_, mask), choices in equal_choices.items():
        table = form.tables[choices[0]]
        rows = form.start[choices][:, None] + np.arange(len(table.directions))  # (G, D)
        y = value[rows - base] + form.offset[rows]
        splits = (
            table.list_divisions(mask)
            if table.has_listed_divisions
            else split_by_sectors(table, mask, y[0])
        )
        gains = rates.select(rows[:, None] - base).compute_gain(
            y[:, None], splits.lower, splits.upper
        )
        evaluated.append((choices, splits, gains))  # (G, children)
    guaranteed_gains = [
        np.minimum.reduceat(g, s.first, axis=1).max(initial=0.0) for _, s, g in evaluated
    ]
    scale = max([*guaranteed_gains, _SMALLEST])
    selected: BranchingChildren | None = None
    best_score = -np.inf
    for choices, splits, gains in evaluated:
        sizes = np.diff([*splits.first, gains.shape[1]])
        logs = np.log(np.clip(gains, _FLOOR * scale, _CAP * scale))
        score = np.add.reduceat(logs, splits.first, axis=1) / sizes
        g, division = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[g, division] > best_score:
            best_score = float(score[g, division])
            span = slice(int(splits.first[division]), int(splits.first[division] + sizes[division]))
            selected = BranchingChildren(choices[int(g)], splits.children[span], gains[g, span])
    assert selected is not None
    return selected
