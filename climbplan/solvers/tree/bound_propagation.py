"""Boxes around the feasible set by interval propagation over rows, balls and choices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.program.row_propagation import Range, RowPropagation
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable
from climbplan.solvers.tree.stacked_choices import StackedChoices

_ROUNDS = 64


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


def propagated_box(
    instance: Instance, tables: list[ChoiceTable], stacked: StackedChoices | None = None
) -> Box:
    """The variable bounds, tightened through rows, ball components and hulls of choices.

    tables: one for each choice; stacked: their rows, if they are there. Only finite
    rows tighten; a variable that nothing bounds keeps an infinite bound.
    """
    rows = [instance.A]
    lower, upper = [instance.row_lower], [instance.row_upper]
    for balls in instance.balls:
        rows.append(balls.F)
        radius = np.repeat(balls.radius, balls.f.shape[1])
        lower.append(-radius - balls.f.ravel())
        upper.append(radius - balls.f.ravel())
    if stacked is None:
        stacked = StackedChoices.of(instance.choices, tables, instance.size)
    hulls = [table.hull(table.everything) for table in tables]
    low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
    high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
    rows.append(stacked.rows)
    lower.append(np.where(low <= -UNBOUNDED, -np.inf, low - stacked.offset))
    upper.append(np.where(high >= UNBOUNDED, np.inf, high - stacked.offset))
    whole = sparse.vstack(rows).tocsr()
    propagation = RowPropagation(whole, np.concatenate(lower), np.concatenate(upper))
    bounds = Range(instance.lower.astype(float), instance.upper.astype(float))
    for _ in range(_ROUNDS):
        before, bounds = bounds, propagation.tightened(bounds)
        if not before.moved_to(bounds):
            break
    return Box(bounds.lower, bounds.upper)


def largest_cost(instance: Instance, box: Box) -> float:
    """An upper bound on the cost of every feasible point, infinite if the box is open."""
    size = np.maximum(np.abs(box.lower), np.abs(box.upper))
    if not np.isfinite(size).all():
        return np.inf
    curved = 0.5 * size @ (abs(instance.P) @ size)
    return float(curved + np.abs(instance.q) @ size + instance.constant)
