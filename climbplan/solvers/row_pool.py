"""All rows known to a search: those of the normal form and the cuts found on the way."""

from __future__ import annotations

import numpy as np

from climbplan.program.polytope import Array
from climbplan.solvers.normal_form import NormalForm
from climbplan.solvers.result import Indices

_SHORT = 1e-12


class RowPool:
    """lower <= M z <= upper; rows are only ever appended, so their numbers stay valid."""

    def __init__(self, form: NormalForm) -> None:
        m, k = form.rows.shape
        self.count = 0
        self._M = np.zeros((2 * m + 256, k))
        self._numbers = np.zeros((3, len(self._M)))  # lower, upper, scale
        self._part = np.zeros(len(self._M), np.int64)
        self.append(form.rows, form.lower, form.upper, form.part)

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
    def part(self) -> Indices:
        """The part in which a row lies, -1 if it couples parts (m,)."""
        return self._part[: self.count]

    def append(self, M: Array, lower: Array, upper: Array, part: Indices) -> None:
        """Add rows."""
        needed = self.count + len(M)
        if needed > len(self._M):
            room = max(needed, 2 * len(self._M)) - len(self._M)
            self._M = np.concatenate([self._M, np.zeros((room, self._M.shape[1]))])
            self._numbers = np.concatenate([self._numbers, np.zeros((3, room))], axis=1)
            self._part = np.concatenate([self._part, np.zeros(room, np.int64)])
        here = slice(self.count, needed)
        length = np.linalg.norm(M, axis=1)
        scale = np.where(length > _SHORT, 1.0 / np.maximum(length, _SHORT), 0.0)
        self._M[here] = M
        self._numbers[:, here] = lower, upper, scale
        self._part[here] = part
        self.count = needed
