"""Structure of an instance without its numbers, which compiled programs share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.program.instance import Instance
from climbplan.program.smooth import SmoothForm
from climbplan.reformulations.conditional_rows import build_indicator_rows, canonicalise


@dataclass(frozen=True)
class Pattern:
    """Hashable sparsity of a matrix."""

    shape: tuple[int, int]
    indptr: tuple[int, ...]
    indices: tuple[int, ...]

    @classmethod
    def of(cls, matrix: sparse.csr_matrix) -> Pattern:
        """Return the pattern of a canonical matrix."""
        return cls(matrix.shape, tuple(matrix.indptr.tolist()), tuple(matrix.indices.tolist()))

    def fill(self, values: Any) -> Any:
        """Return the CasADi matrix with these nonzeros, row by row."""
        rows, columns = self.shape
        transposed = ca.Sparsity(columns, rows, list(self.indptr), list(self.indices))
        return ca.SX(transposed, values).T

    def list_nonempty_rows(self) -> IntArray:
        """Return the rows with at least one entry."""
        return np.flatnonzero(np.diff(self.indptr))


@dataclass(frozen=True)
class Structure:
    """The structure of an instance without its numbers."""

    size: int
    P: Pattern
    A: Pattern
    Q: Pattern
    first: tuple[int, ...]
    second: tuple[int, ...]
    balls: tuple[tuple[Pattern, int], ...]  # rows and dimension
    choices: tuple[int, ...]  # alternatives of each
    conditional_A: Pattern
    conditional_Q: Pattern
    indicator: tuple[int, ...]
    value: tuple[bool, ...]
    bounded: tuple[tuple[bool, bool, bool], ...]  # indicator rows: below, above, equal
    integer: tuple[int, ...]
    smooth: SmoothForm | None = None

    @classmethod
    def of(cls, instance: Instance) -> Structure:
        """Return the structure of an instance."""
        rows = build_indicator_rows(instance)
        equal = rows.lower == rows.upper
        ends = (np.isfinite(rows.lower) & ~equal, np.isfinite(rows.upper) & ~equal, equal)
        return cls(
            size=instance.size,
            P=Pattern.of(canonicalise(instance.P.tocsr())),
            A=Pattern.of(canonicalise(instance.A)),
            Q=Pattern.of(canonicalise(instance.Q)),
            first=tuple(instance.products.first.tolist()),
            second=tuple(instance.products.second.tolist()),
            balls=tuple((Pattern.of(canonicalise(b.F)), b.f.shape[1]) for b in instance.balls),
            choices=tuple(len(c.alternatives) for c in instance.choices),
            conditional_A=Pattern.of(rows.A),
            conditional_Q=Pattern.of(rows.Q),
            indicator=tuple(rows.indicator.tolist()),
            value=tuple(rows.value.tolist()),
            bounded=tuple(zip(*(end.tolist() for end in ends), strict=True)),
            integer=tuple(np.flatnonzero(instance.integer).tolist()),
            smooth=None if instance.smooth is None else instance.smooth.form,
        )
