"""Parts of an instance that only its rows and balls couple.

Variables belong together where the cost, an equation or a choice links them. In the posture problem
each limb's toe positions are one part; body and limbs meet in the workspace balls alone. Minima of
parts add up to lower bounds on the whole, so the search keeps them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.choice_table import ChoiceTable
from climbplan.solvers.result import Indices

SAME = 1e-9  # bounds closer than this are one value


@dataclass(frozen=True)
class Equations:
    """E x = e that every feasible point satisfies, not always stated as such."""

    E: sparse.csr_matrix  # (k, n)
    e: Array  # (k,)


@dataclass(frozen=True)
class Components:
    """Part of each variable and of each choice."""

    count: int
    variable: Indices  # (n,)
    choice: Indices  # (C,), -1 if no variable enters

    def of_rows(self, rows: sparse.csr_matrix) -> Indices:
        """The part in which each row lies, -1 if in several or in none."""
        rows = sparse.csr_matrix(rows)
        m = rows.shape[0]
        entry = rows.tocoo()
        part = self.variable[entry.col]
        low, high = np.full(m, self.count), np.full(m, -1)
        np.minimum.at(low, entry.row, part)
        np.maximum.at(high, entry.row, part)
        return np.where(low == high, low, -1)


def equations(instance: Instance, tables: list[ChoiceTable]) -> Equations:
    """Fixed variables, rows with equal bounds, and planes that all alternatives share."""
    fixed = np.flatnonzero(instance.upper - instance.lower <= SAME)
    tight = np.flatnonzero(instance.row_upper - instance.row_lower <= SAME)
    unit = sparse.identity(instance.size, format="csr")
    rows = [unit[fixed], instance.A[tight]]
    values = [
        0.5 * (instance.lower[fixed] + instance.upper[fixed]),
        0.5 * (instance.row_lower[tight] + instance.row_upper[tight]),
    ]
    for choice, table in zip(instance.choices, tables, strict=True):
        low, high = table.hull((1 << table.count) - 1)
        shared = np.flatnonzero(high - low <= SAME)
        if len(shared):
            directions = table.directions[shared]
            rows.append(sparse.csr_matrix(directions) @ choice.E)
            values.append(0.5 * (low + high)[shared] - directions @ choice.e)
    return Equations(sparse.vstack(rows).tocsr(), np.concatenate(values))


def components(instance: Instance, equal: Equations) -> Components:
    """Connected components of the graph of cost, equations and choices."""
    n = instance.size
    ones: list[sparse.csr_matrix] = [abs(equal.E), *(_any_row(c.E) for c in instance.choices)]
    links = sparse.vstack(ones).tocsr()
    links.data[:] = 1.0
    cost = abs(instance.P).tocsr()
    count, label = connected_components(cost + links.T @ links, directed=False)
    choice = [label[c.E.indices[0]] if c.E.nnz else -1 for c in instance.choices]
    assert len(label) == n
    return Components(int(count), label.astype(np.int64), np.array(choice, np.int64))


def _any_row(rows: sparse.csr_matrix) -> sparse.csr_matrix:
    """One row with the union of all rows' columns."""
    columns = np.unique(rows.indices)
    ones = np.ones(len(columns))
    return sparse.csr_matrix((ones, columns, [0, len(columns)]), shape=(1, rows.shape[1]))
