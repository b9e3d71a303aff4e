"""Row directions of all choices of an instance, stacked into one sparse matrix."""

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
    """Map from x to the values rows x + offset of all choices along their directions."""

    E: sparse.csr_matrix  # (sum d, n) points of all choices
    e: Array  # (sum d,)
    choice: IntArray  # (sum d,) choice to whose point a row of E belongs
    rows: sparse.csr_matrix  # (sum D, n)
    offset: Array  # (sum D,)
    start: IntArray  # (C + 1,) first row of each choice

    @classmethod
    def stack(
        cls, choices: Sequence[Choice], tables: Sequence[ChoiceTable], size: int
    ) -> StackedChoices:
        """Stack the directions of choices over x of some size."""
        E = sparse.vstack([sparse.csr_matrix((0, size)), *(c.E for c in choices)]).tocsr()
        e = np.concatenate([np.zeros(0), *(c.e for c in choices)])
        dimension = np.array([len(c.e) for c in choices], np.int64)
        start = np.cumsum([0, *(len(t.directions) for t in tables)]).astype(np.int64)
        point_start = np.cumsum(dimension) - dimension
        entries_of_table: dict[int, tuple[IntArray, IntArray, Array]] = {}
        entries: list[tuple[IntArray, IntArray, Array]] = []
        for c, table in enumerate(tables):
            if id(table) not in entries_of_table:
                r, k = np.nonzero(table.directions)
                entries_of_table[id(table)] = (r, k, table.directions[r, k])
            r, k, value = entries_of_table[id(table)]
            entries.append((r + start[c], k + point_start[c], value))
        no_index = np.zeros(0, np.int64)
        row = np.concatenate([no_index, *(r for r, _, _ in entries)])
        column = np.concatenate([no_index, *(k for _, k, _ in entries)])
        value = np.concatenate([np.zeros(0), *(v for _, _, v in entries)])
        directions = sparse.csr_matrix((value, (row, column)), shape=(int(start[-1]), len(e)))
        return cls(
            E=E,
            e=e,
            choice=np.repeat(np.arange(len(dimension)), dimension),
            rows=(directions @ E).tocsr(),
            offset=np.asarray(directions @ e),
            start=start,
        )
