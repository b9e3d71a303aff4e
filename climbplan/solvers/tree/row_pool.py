"""All rows known to a search: those of the normal form, cuts, and rows of single alternatives.

What an alternative states is held by the nodes that chose it and by no others, so that its rows
have no bounds here: a table that is seen along few directions has them added where a node needs
them first, once for all later nodes.
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
class OwnRange:
    """The rows of one alternative in the pool."""

    here: slice
    lower: Array  # (q,)
    upper: Array  # (q,)


class RowPool:
    """lower <= M z <= upper; rows are only ever appended, so their numbers stay valid."""

    def __init__(self, form: NormalForm) -> None:
        m, k = form.rows.shape
        self.count = 0
        self._M = np.zeros((m + max(m // 2, 512), k))
        self._numbers = np.zeros((3, len(self._M)))  # lower, upper, scale
        self._part = np.zeros(len(self._M), np.int64)
        self._is_own = np.zeros(len(self._M), bool)
        self._own: dict[tuple[int, int], OwnRange] = {}
        self._form = form
        self.append(form.rows, form.lower, form.upper, form.part)

    def own(self, choice: int, alternative: int) -> OwnRange:
        """Where the rows of one alternative of a choice stand, and their bounds."""
        known = self._own.get((choice, alternative))
        if known is None:
            made = self._form.own_rows(choice, alternative)
            here = slice(self.count, self.count + len(made.rows))
            free = np.full(len(made.rows), UNBOUNDED)
            part = np.full(len(made.rows), self._form.choice_part[choice])
            self.append(made.rows, -free, free, part)
            self._is_own[here] = True
            known = OwnRange(here, made.lower, made.upper)
            self._own[choice, alternative] = known
        return known

    @property
    def bytes(self) -> int:
        """What the rows take."""
        return int(self._M.nbytes + self._numbers.nbytes + self._part.nbytes)

    @property
    def is_own(self) -> BoolArray:
        """Which rows are those of one alternative (m,)."""
        return self._is_own[: self.count]

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
    def part(self) -> IntArray:
        """The part in which a row lies, -1 if it couples parts (m,)."""
        return self._part[: self.count]

    def append(self, M: Array, lower: Array, upper: Array, part: IntArray) -> None:
        """Add rows."""
        needed = self.count + len(M)
        if needed > len(self._M):
            room = max(needed, int(_GROWTH * len(self._M))) - len(self._M)
            self._M = np.concatenate([self._M, np.zeros((room, self._M.shape[1]))])
            self._numbers = np.concatenate([self._numbers, np.zeros((3, room))], axis=1)
            self._part = np.concatenate([self._part, np.zeros(room, np.int64)])
            self._is_own = np.concatenate([self._is_own, np.zeros(room, bool)])
        here = slice(self.count, needed)
        length = np.linalg.norm(M, axis=1)
        scale = np.where(length > _SHORT, 1.0 / np.maximum(length, _SHORT), 0.0)
        self._M[here] = M
        self._numbers[:, here] = lower, upper, scale
        self._part[here] = part
        self.count = needed
