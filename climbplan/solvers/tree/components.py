"""Components of an instance that only its rows and balls couple.

Variables belong together where the cost, an equation or a choice links them. In the posture problem
the toe positions of each limb are one component, and only the workspace balls couple body and
limbs. Minima of components add up to lower bounds on the whole, so the search keeps them separate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.tree.choice_table import ChoiceTable
from climbplan.solvers.tree.stacked_choices import StackedChoices

SAME = 1e-9  # bounds closer than this are equal


@dataclass(frozen=True)
class Equations:
    """Equations E x = e that every feasible point satisfies, stated or implied."""

    E: sparse.csr_matrix  # (k, n)
    e: Array  # (k,)


@dataclass(frozen=True)
class Components:
    """Component of each variable and of each choice."""

    count: int
    variable: IntArray  # (n,)
    choice: IntArray  # (C,), -1 if no variable enters

    def locate_rows(self, rows: sparse.csr_matrix) -> IntArray:
        """Return the component of each row, -1 if it lies in several or in none."""
        rows = sparse.csr_matrix(rows)
        m = rows.shape[0]
        entry = rows.tocoo()
        component = self.variable[entry.col]
        low, high = np.full(m, self.count), np.full(m, -1)
        np.minimum.at(low, entry.row, component)
        np.maximum.at(high, entry.row, component)
        return np.where(low == high, low, -1)


def find_equations(
    instance: Instance, tables: list[ChoiceTable], stacked: StackedChoices
) -> Equations:
    """Collect fixed variables, rows with equal bounds, and planes that all alternatives share."""
    fixed = np.flatnonzero(instance.upper - instance.lower <= SAME)
    tight = np.flatnonzero(instance.row_upper - instance.row_lower <= SAME)
    unit = sparse.identity(instance.size, format="csr")
    rows = [unit[fixed], instance.A[tight]]
    values = [
        0.5 * (instance.lower[fixed] + instance.upper[fixed]),
        0.5 * (instance.row_lower[tight] + instance.row_upper[tight]),
    ]
    hulls = [table.compute_hull(table.all_alternatives) for table in tables]
    low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
    high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
    shared = np.flatnonzero(high - low <= SAME)
    if len(shared):
        rows.append(stacked.rows[shared])
        values.append(0.5 * (low + high)[shared] - stacked.offset[shared])
    return Equations(sparse.vstack(rows).tocsr(), np.concatenate(values))


def find_components(instance: Instance, equal: Equations, stacked: StackedChoices) -> Components:
    """Find the connected components of the graph of cost, equations and choices."""
    n = instance.size
    entry = stacked.E.tocoo()
    owner = stacked.choice[entry.row]
    count = len(instance.choices)
    choice_variables = sparse.csr_matrix((np.ones(entry.nnz), (owner, entry.col)), shape=(count, n))
    links = sparse.vstack([abs(equal.E), choice_variables]).tocsr()
    links.data[:] = 1.0
    cost = abs(instance.P).tocsr()
    num_components, label = connected_components(cost + links.T @ links, directed=False)
    assert len(label) == n
    choice = np.full(count, -1)
    choice[owner] = label[entry.col]
    return Components(int(num_components), label.astype(np.int64), choice)
