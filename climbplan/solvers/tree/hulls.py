"""What choices and the box around the feasible set tell a search before it begins."""

from __future__ import annotations

import numpy as np

from climbplan.program.box import Box, Hulls
from climbplan.program.instance import Instance
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable
from climbplan.solvers.tree.stacked_choices import StackedChoices


def choice_hulls(
    instance: Instance, tables: list[ChoiceTable], stacked: StackedChoices | None = None
) -> Hulls:
    """Hulls of the alternatives along the row directions of each choice.

    tables: one for each choice; stacked: their rows, if they are there.
    """
    if stacked is None:
        stacked = StackedChoices.of(instance.choices, tables, instance.size)
    hulls = [table.hull(table.everything) for table in tables]
    low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
    high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
    return Hulls(
        stacked.rows,
        np.where(low <= -UNBOUNDED, -np.inf, low - stacked.offset),
        np.where(high >= UNBOUNDED, np.inf, high - stacked.offset),
    )


def largest_cost(instance: Instance, box: Box) -> float:
    """An upper bound on the cost of every feasible point, infinite if the box is open."""
    size = np.maximum(np.abs(box.lower), np.abs(box.upper))
    if not np.isfinite(size).all():
        return np.inf
    curved = 0.5 * size @ (abs(instance.P) @ size)
    return float(curved + np.abs(instance.q) @ size + instance.constant)
