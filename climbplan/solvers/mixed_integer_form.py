"""An instance as other mixed-integer solvers read it: squares, balls, and binaries.

Cost: 1/2 sum u_j^2 with u = U x + offset from a Cholesky factor, so that steps between rounds
appear as single differences. Choices: with one binary b_r an alternative, sum b = 1, and along each
direction d of the choice sum lower_r b_r <= d'y <= sum upper_r b_r. The bounds come from the
alternatives' vertices, or from the variables' box where an alternative says nothing: no big-M is
typed in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.box import Box, propagated_box
from climbplan.program.instance import Instance
from climbplan.solvers.separable_cost import SeparableCost, separable_cost
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable, choice_tables
from climbplan.solvers.tree.hulls import choice_hulls

_ENTRIES = 10e6  # of rows of binaries; some 200 bytes each once a model is built of them


@dataclass(frozen=True)
class ChoiceRow:
    """lower b <= row x <= upper b for the binaries b of one choice."""

    choice: int
    row: sparse.csr_matrix  # (1, n)
    lower: Array | None  # (R,)
    upper: Array | None


@dataclass(frozen=True)
class MixedIntegerForm:
    """What a model is built from besides the instance itself."""

    box: Box
    squares: SeparableCost
    choice_rows: tuple[ChoiceRow, ...]


def mixed_integer_form(instance: Instance) -> MixedIntegerForm:
    """Raises UsageError for a point that is not bounded where it has to be, and for huge forms."""
    tables = choice_tables(instance.choices, every_row=True)
    entries = sum(2 * table.lower.size for table in tables)
    if entries > _ENTRIES:
        raise UsageError(
            f"{instance.name}: {1e-6 * entries:.0f} million entries of binaries are more than this "
            "solver is given: use branch-and-bound, which needs none"
        )
    box = propagated_box(instance, choice_hulls(instance, tables))
    rows = [row for c, table in enumerate(tables) for row in _choice_rows(instance, c, table, box)]
    return MixedIntegerForm(box, separable_cost(instance), tuple(rows))


def _choice_rows(instance: Instance, c: int, table: ChoiceTable, box: Box) -> list[ChoiceRow]:
    choice = instance.choices[c]
    E = sparse.csr_matrix(sparse.csr_matrix(table.directions) @ choice.E)
    offset = table.directions @ choice.e
    reach = box.interval(E)
    least, most = reach.lower + offset, reach.upper + offset
    rows = []
    for d in range(len(offset)):
        lower = np.maximum(table.lower[:, d], least[d])
        upper = np.minimum(table.upper[:, d], most[d])
        needs = (
            table.lower[:, d].max() > -UNBOUNDED,
            table.upper[:, d].min() < UNBOUNDED,
        )
        if (needs[0] and np.isinf(lower).any()) or (needs[1] and np.isinf(upper).any()):
            raise UsageError(
                f"{choice.name}: its point is not bounded, which this solver needs; "
                "give its variables bounds or use branch-and-bound"
            )
        rows.append(
            ChoiceRow(
                c,
                E[d],
                lower - offset[d] if needs[0] else None,
                upper - offset[d] if needs[1] else None,
            )
        )
    return rows
