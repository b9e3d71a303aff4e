"""Pool of all rows of a search: normal form, cuts, and rows of single alternatives.

Rows of an alternative hold only at nodes that have chosen it, so they have no bounds here. Tables
with few directions add them where a node needs them first, once for all later nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.tree.choice_table import UNBOUNDED
from climbplan.solvers.tree.normal_form import NormalForm

_SHORT = 1e-12
_GROWTH = 1.6


@dataclass(frozen=True)
class AlternativeRows:
    """Rows of one alternative in the pool."""

    span: slice
    lower: Array  # (q,)
    upper: Array  # (q,)


class RowPool:
    """Rows lower <= M z <= upper; they are only appended, so their indices stay valid."""

    def __init__(self, form: NormalForm) -> None:
        """Begin with the rows of the normal form."""
        m, k = form.rows.shape
        self.count = 0
        self._M = np.zeros((m + max(m // 2, 512), k))
        self._numbers = np.zeros((3, len(self._M)))  # lower, upper, scale
        self._component = np.zeros(len(self._M), np.int64)
        self._is_of_alternative = np.zeros(len(self._M), bool)
        self._alternatives: dict[tuple[int, int], AlternativeRows] = {}
        self._form = form
        self.append(form.rows, form.lower, form.upper, form.component)

    def ensure_alternative(self, choice: int, alternative: int) -> AlternativeRows:
        """Return the rows of one alternative of a choice, and add them if they are missing."""
        alternative_rows = self._alternatives.get((choice, alternative))
        if alternative_rows is None:
            rows = self._form.build_alternative_rows(choice, alternative)
            span = slice(self.count, self.count + len(rows.rows))
            unbounded = np.full(len(rows.rows), UNBOUNDED)
            component = np.full(len(rows.rows), self._form.choice_component[choice])
            self.append(rows.rows, -unbounded, unbounded, component)
            self._is_of_alternative[span] = True
            alternative_rows = AlternativeRows(span, rows.lower, rows.upper)
            self._alternatives[choice, alternative] = alternative_rows
        return alternative_rows

    @property
    def num_bytes(self) -> int:
        """Memory of the rows [bytes]."""
        return int(self._M.nbytes + self._numbers.nbytes + self._component.nbytes)

    @property
    def is_of_alternative(self) -> BoolArray:
        """Mask of the rows of single alternatives (m,)."""
        return self._is_of_alternative[: self.count]

    @property
    def M(self) -> Array:
        """Rows (m, k)."""
        return self._M[: self.count]

    @property
    def lower(self) -> Array:
        """Lower bounds (m,)."""
        return self._numbers[0, : self.count]

    @property
    def upper(self) -> Array:
        """Upper bounds (m,)."""
        return self._numbers[1, : self.count]

    @property
    def scale(self) -> Array:
        """1 / |row|, 0 for rows that do not depend on z (m,)."""
        return self._numbers[2, : self.count]

    @property
    def component(self) -> IntArray:
        """Component in which a row lies, -1 if it couples components (m,)."""
        return self._component[: self.count]

    def append(self, M: Array, lower: Array, upper: Array, component: IntArray) -> None:
        """Append rows."""
        count = self.count + len(M)
        if count > len(self._M):
            added = max(count, int(_GROWTH * len(self._M))) - len(self._M)
            self._M = np.concatenate([self._M, np.zeros((added, self._M.shape[1]))])
            self._numbers = np.concatenate([self._numbers, np.zeros((3, added))], axis=1)
            self._component = np.concatenate([self._component, np.zeros(added, np.int64)])
            self._is_of_alternative = np.concatenate(
                [self._is_of_alternative, np.zeros(added, bool)]
            )
        span = slice(self.count, count)
        length = np.linalg.norm(M, axis=1)
        scale = np.where(length > _SHORT, 1.0 / np.maximum(length, _SHORT), 0.0)
        self._M[span] = M
        self._numbers[:, span] = lower, upper, scale
        self._component[span] = component
        self.count = count
