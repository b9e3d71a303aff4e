"""The row directions of all choices of an instance, stacked: one sparse product instead of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Choice
from climbplan.solvers.tree.choice_table import ChoiceTable


@dataclass(frozen=True)
class StackedChoices:
    """rows x + offset are the values of all choices along the directions of their tables."""

    E: sparse.csr_matrix  # (sum d, n) points of all choices
    e: Array  # (sum d,)
    choice: IntArray  # (sum d,) whose point a row of E belongs to
    rows: sparse.csr_matrix  # (sum D, n)
    offset: Array  # (sum D,)
    start: IntArray  # (C + 1,) first row of each choice

    @classmethod
    def of(
        cls, choices: Sequence[Choice], tables: Sequence[ChoiceTable], size: int
    ) -> StackedChoices:
        """size: n."""
        E = sparse.vstack([sparse.csr_matrix((0, size)), *(c.E for c in choices)]).tocsr()
        e = np.concatenate([np.zeros(0), *(c.e for c in choices)])
        dimension = np.array([len(c.e) for c in choices], np.int64)
        start = np.cumsum([0, *(len(t.directions) for t in tables)]).astype(np.int64)
        first = np.cumsum(dimension) - dimension
        known: dict[int, tuple[IntArray, IntArray, Array]] = {}
        entries: list[tuple[IntArray, IntArray, Array]] = []
        for c, table in enumerate(tables):
            if id(table) not in known:
                r, k = np.nonzero(table.directions)
                known[id(table)] = (r, k, table.directions[r, k])
            r, k, value = known[id(table)]
            entries.append((r + start[c], k + first[c], value))
        none = np.zeros(0, np.int64)
        row = np.concatenate([none, *(r for r, _, _ in entries)])
        column = np.concatenate([none, *(k for _, k, _ in entries)])
        value = np.concatenate([np.zeros(0), *(v for _, _, v in entries)])
        along = sparse.csr_matrix((value, (row, column)), shape=(int(start[-1]), len(e)))
        return cls(
            E=E,
            e=e,
            choice=np.repeat(np.arange(len(dimension)), dimension),
            rows=(along @ E).tocsr(),
            offset=np.asarray(along @ e),
            start=start,
        )
