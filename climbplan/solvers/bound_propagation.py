"""Boxes around the feasible set by interval propagation over rows, balls and choices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.choice_table import UNBOUNDED, ChoiceTable
from climbplan.solvers.result import Indices

_ROUNDS = 64
_PROGRESS = 1e-3  # a round that moves no bound by more than this share is the last
_WEAK = 1e-7  # entries below this share of a row's largest bound no variable
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Box:
    """Bounds that hold for every feasible x."""

    lower: Array  # (n,)
    upper: Array  # (n,)

    @property
    def half(self) -> Array:
        """Half the width, infinite where the box is open (n,)."""
        return 0.5 * (self.upper - self.lower)

    @property
    def middle(self) -> Array:
        """The centre, 0 where the box is open (n,)."""
        closed = np.isfinite(self.lower) & np.isfinite(self.upper)
        low, high = np.where(closed, self.lower, 0.0), np.where(closed, self.upper, 0.0)
        return 0.5 * (low + high)

    def interval(self, rows: sparse.csr_matrix, offset: Array) -> tuple[Array, Array]:
        """Range of rows x + offset over the box."""
        positive, negative = rows.maximum(0), rows.minimum(0)
        low, high = np.maximum(self.lower, -UNBOUNDED), np.minimum(self.upper, UNBOUNDED)
        least = positive @ low + negative @ high + offset
        most = positive @ high + negative @ low + offset
        return (
            np.where(least < -0.5 * UNBOUNDED, -np.inf, least),
            np.where(most > 0.5 * UNBOUNDED, np.inf, most),
        )


def propagated_box(instance: Instance, tables: list[ChoiceTable]) -> Box:
    """The variable bounds, tightened through rows, ball components and hulls of choices.

    tables: one for each choice. Only finite rows tighten; a variable that nothing bounds keeps an
    infinite bound.
    """
    rows = [instance.A]
    lower, upper = [instance.row_lower], [instance.row_upper]
    for balls in instance.balls:
        rows.append(balls.F)
        radius = np.repeat(balls.radius, balls.f.shape[1])
        lower.append(-radius - balls.f.ravel())
        upper.append(radius - balls.f.ravel())
    for choice, table in zip(instance.choices, tables, strict=True):
        low, high = table.hull((1 << table.count) - 1)
        rows.append(sparse.csr_matrix(table.directions) @ choice.E)
        offset = table.directions @ choice.e
        lower.append(np.where(low <= -UNBOUNDED, -np.inf, low - offset))
        upper.append(np.where(high >= UNBOUNDED, np.inf, high - offset))
    stacked = sparse.vstack(rows).tocsr()
    return _propagate(stacked, np.concatenate(lower), np.concatenate(upper), instance)


def largest_cost(instance: Instance, box: Box) -> float:
    """An upper bound on the cost of every feasible point, infinite if the box is open."""
    size = np.maximum(np.abs(box.lower), np.abs(box.upper))
    if not np.isfinite(size).all():
        return np.inf
    curved = 0.5 * size @ (abs(instance.P) @ size)
    return float(curved + np.abs(instance.q) @ size + instance.constant)


def _propagate(
    rows: sparse.csr_matrix, row_lower: Array, row_upper: Array, instance: Instance
) -> Box:
    """Bound every variable by every row, given the bounds of the row's other variables."""
    rows.eliminate_zeros()
    entry = rows.tocoo()
    i, j, a = entry.row, entry.col, entry.data
    m = rows.shape[0]
    largest = np.zeros(m)
    np.maximum.at(largest, i, np.abs(a))
    strong = np.abs(a) > _WEAK * largest[i]  # division by a weak entry would only amplify rounding
    low, high = instance.lower.astype(float).copy(), instance.upper.astype(float).copy()
    for _ in range(_ROUNDS):
        # A row's parts without an entry's own bound what is left for the entry.
        rest_low = _rest(np.where(a > 0, a * low[j], a * high[j]), i, m)
        rest_high = _rest(np.where(a > 0, a * high[j], a * low[j]), i, m)
        one, other = (row_lower[i] - rest_high) / a, (row_upper[i] - rest_low) / a
        new_low, new_high = low.copy(), high.copy()
        np.maximum.at(new_low, j[strong], np.minimum(one, other)[strong] - _ROUNDING)
        np.minimum.at(new_high, j[strong], np.maximum(one, other)[strong] + _ROUNDING)
        first = np.isinf(low) & np.isfinite(new_low) | np.isinf(high) & np.isfinite(new_high)
        with np.errstate(invalid="ignore"):
            moved = np.nan_to_num(np.maximum(new_low - low, high - new_high), nan=0.0)
        width = np.maximum(new_high - new_low, _ROUNDING)
        low, high = new_low, new_high
        if not (first | (moved > _PROGRESS * width)).any():
            break
    return Box(low, high)


def _rest(part: Array, row: Indices, m: int) -> Array:
    """Sum of a row's parts without each entry's own; infinite if another part is."""
    infinite = np.isinf(part)
    total = np.bincount(row, np.where(infinite, 0.0, part), m)[row]
    others = np.bincount(row, infinite, m)[row] - infinite
    sign = np.sign(np.bincount(row, np.where(infinite, np.sign(part), 0.0), m)[row])
    rest = total - np.where(infinite, 0.0, part)
    return np.where(others > 0, np.where(sign < 0, -np.inf, np.inf), rest)
