"""Hulls of choices, and an upper bound on the cost over a box."""

from __future__ import annotations

import numpy as np

from climbplan.program.box import Hulls, VariableBox
from climbplan.program.instance import Instance
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable
from climbplan.solvers.tree.stacked_choices import StackedChoices


def build_choice_hulls(
    instance: Instance, tables: list[ChoiceTable], stacked: StackedChoices | None = None
) -> Hulls:
    """Return hulls of the alternatives along the row directions of each choice.

    Args:
        instance: Instance with choices.
        tables: One table for each choice.
        stacked: Stacked rows of the tables, computed if missing.
    """
    if stacked is None:
        stacked = StackedChoices.stack(instance.choices, tables, instance.size)
    hulls = [table.compute_hull(table.all_alternatives) for table in tables]
    low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
    high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
    return Hulls(
        stacked.rows,
        np.where(low <= -UNBOUNDED, -np.inf, low - stacked.offset),
        np.where(high >= UNBOUNDED, np.inf, high - stacked.offset),
    )


def compute_max_cost(instance: Instance, box: VariableBox) -> float:
    """Return an upper bound on the cost of every feasible point, infinite if the box is open."""
    max_abs = np.maximum(np.abs(box.lower), np.abs(box.upper))
    if not np.isfinite(max_abs).all():
        return np.inf
    curved = 0.5 * max_abs @ (abs(instance.P) @ max_abs)
    return float(curved + np.abs(instance.q) @ max_abs + instance.constant)
