"""An instance in the form of other mixed-integer solvers: squares, balls, and binaries.

The cost is 1/2 sum u_j^2 with u = U x + offset from a Cholesky factor, so steps between rounds
appear as single differences. A choice has one binary b_r for each alternative, with sum b = 1, and
sum lower_r b_r <= d'y <= sum upper_r b_r along each of its directions d. The bounds are those of
the alternatives' vertices, or of the variables' box where an alternative has none; no big-M is
chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Instance
from climbplan.solvers.separable_cost import SeparableCost, factor_cost
from climbplan.solvers.tree.choice_hulls import build_choice_hulls
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable, build_choice_tables

_MAX_ENTRIES = 10e6  # largest number of entries of binaries, each some 200 bytes in a model
_INDISTINCT = 1e-6  # difference of bounds that solvers with row tolerances cannot tell apart


@dataclass(frozen=True)
class ChoiceRow:
    """Row lower b <= row x <= upper b for the binaries b of one choice."""

    choice: int
    row: sparse.csr_matrix  # (1, n)
    lower: Array | None  # (R,)
    upper: Array | None


@dataclass(frozen=True)
class MixedIntegerForm:
    """Parts of a model in addition to the instance itself."""

    box: VariableBox
    squares: SeparableCost
    choice_rows: tuple[ChoiceRow, ...]


def build_mixed_integer_form(instance: Instance) -> MixedIntegerForm:
    """Build the form of an instance with choices.

    Raises:
        UsageError: A point is not bounded where it has to be, or the form is too large.
    """
    tables = build_choice_tables(instance.choices, every_row=True)
    entries = sum(2 * table.lower.size for table in tables)
    if entries > _MAX_ENTRIES:
        raise UsageError(
            f"{instance.name}: {1e-6 * entries:.0f} million entries of binaries are more than this "
            "solver is given: use branch-and-bound, which needs none"
        )
    box = propagate_box(instance, build_choice_hulls(instance, tables))
    rows = [
        row for c, table in enumerate(tables) for row in _build_choice_rows(instance, c, table, box)
    ]
    return MixedIntegerForm(box, factor_cost(instance), tuple(rows))


def _build_choice_rows(
    instance: Instance, c: int, table: ChoiceTable, box: VariableBox
) -> list[ChoiceRow]:
    """Build the rows of one choice."""
    choice = instance.choices[c]
    E = sparse.csr_matrix(sparse.csr_matrix(table.directions) @ choice.E)
    offset = table.directions @ choice.e
    reach = box.interval(E)
    minimum, maximum = reach.lower + offset, reach.upper + offset
    rows = []
    for d in range(len(offset)):
        lower = np.maximum(table.lower[:, d], minimum[d])
        upper = np.minimum(table.upper[:, d], maximum[d])
        is_needed = (
            table.lower[:, d].max() > -UNBOUNDED,
            table.upper[:, d].min() < UNBOUNDED,
        )
        if (is_needed[0] and np.isinf(lower).any()) or (is_needed[1] and np.isinf(upper).any()):
            raise UsageError(
                f"{choice.name}: its point is not bounded, which this solver needs; "
                "give its variables bounds or use branch-and-bound"
            )
        rows.append(
            ChoiceRow(
                c,
                E[d],
                -_merge_bounds(offset[d] - lower) if is_needed[0] else None,
                _merge_bounds(upper - offset[d]) if is_needed[1] else None,
            )
        )
    return rows


def _merge_bounds(upper: Array) -> Array:
    """Return upper bounds (R,) in which values closer than a solver's tolerance are the same.

    Each group has its largest value, so nothing is cut off. Differences of 1e-9, as between the
    bound of an alternative and that of a propagated box, become coefficients of binaries. SCIP
    aggregates variables by such coefficients, and then reports feasible programs as infeasible.
    """
    order = np.argsort(-upper)
    merged = upper.copy()
    for previous, k in pairwise(order):
        if upper[previous] - upper[k] <= _INDISTINCT:
            merged[k] = merged[previous]
    return merged
