"""An instance as other mixed-integer solvers read it: squares, balls, and binaries.

Cost: 1/2 sum u_j^2 with u = U x + offset from a Cholesky factor, so that steps between rounds
appear as single differences. Choices: with one binary b_r an alternative, sum b = 1, and along every
direction d of the choice sum lower_r b_r <= d'y <= sum upper_r b_r. The bounds come from the
alternatives' vertices, or from the variables' box where an alternative says nothing: no big-M is
typed in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.bound_propagation import Box, propagated_box
from climbplan.solvers.choice_table import UNBOUNDED, ChoiceTable

_ZERO = 1e-12
_FLAT = 1e-12


@dataclass(frozen=True)
class Squares:
    """1/2 |U x + offset|^2 + slope x + constant."""

    U: sparse.csr_matrix
    offset: Array
    slope: Array  # (n,) only along directions without curvature
    constant: float


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
    squares: Squares
    choice_rows: tuple[ChoiceRow, ...]


def mixed_integer_form(instance: Instance) -> MixedIntegerForm:
    """Raises UsageError if a choice's point is not bounded along a direction that needs it."""
    tables = [ChoiceTable.of(choice.alternatives) for choice in instance.choices]
    box = propagated_box(instance, tables)
    rows = [row for c, table in enumerate(tables) for row in _choice_rows(instance, c, table, box)]
    return MixedIntegerForm(box, _squares(instance), tuple(rows))


def _choice_rows(instance: Instance, c: int, table: ChoiceTable, box: Box) -> list[ChoiceRow]:
    choice = instance.choices[c]
    E = sparse.csr_matrix(sparse.csr_matrix(table.directions) @ choice.E)
    offset = table.directions @ choice.e
    least, most = box.interval(E, offset)
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


def _squares(instance: Instance) -> Squares:
    n = instance.size
    P = instance.P.toarray()
    count, label = connected_components(abs(instance.P), directed=False)
    U: list[sparse.csr_matrix] = []
    offsets: list[Array] = []
    slope, constant = np.zeros(n), instance.constant
    for part in range(count):
        index = np.flatnonzero(label == part)
        H, g = P[np.ix_(index, index)], instance.q[index]
        try:
            factor = np.linalg.cholesky(H).T
            offset = np.linalg.solve(factor.T, g)
        except np.linalg.LinAlgError:
            value, vector = np.linalg.eigh(H)
            curved = value > _FLAT * max(1.0, float(value.max()))
            factor = np.sqrt(value[curved])[:, None] * vector[:, curved].T
            offset = (vector[:, curved].T @ g) / np.sqrt(value[curved])
            slope[index] = vector[:, ~curved] @ (vector[:, ~curved].T @ g)
        factor[np.abs(factor) < _ZERO] = 0.0
        constant -= float(0.5 * offset @ offset)
        place = sparse.csr_matrix(
            (np.ones(len(index)), (np.arange(len(index)), index)), shape=(len(index), n)
        )
        U.append(sparse.csr_matrix(factor) @ place)
        offsets.append(offset)
    return Squares(
        sparse.vstack(U).tocsr() if U else sparse.csr_matrix((0, n)),
        np.concatenate([np.zeros(0), *offsets]),
        slope,
        constant,
    )
