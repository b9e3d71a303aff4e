"""What proves a lower bound, or that nothing is feasible: leaves that cover all integers.

Each leaf is a set of integers with multipliers of the rows, whose Lagrangian bounds the cost of
every point with these integers. How they were found is of no concern to whoever checks them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.program.polytope import Array


@dataclass(frozen=True)
class Certificate:
    """A proof about an instance with n variables, I of them integers.

    Its choices have R alternatives in all, its balls D coordinates in all, and rows are counted as
    in `rows.StatedRows`: m plain ones, those of implications, those of alternatives.
    """

    lower: Array  # (n,) all feasible points lie in this box
    upper: Array
    low: NDArray[np.int64]  # (S, I) least value of each integer in a leaf
    high: NDArray[np.int64]
    allowed: NDArray[np.bool_]  # (S, R) alternatives of a leaf
    point: Array  # (S, n) where the cost is linearised
    multiplier: sparse.csr_matrix  # (S, rows) positive: of the lower side, negative: the upper one
    ball: Array  # (S, D) multiplier times direction
    empty: NDArray[np.bool_]  # (S,) the multipliers prove that the leaf has no point
    bound: float  # what the leaves prove together, infinite if nothing is feasible

    @property
    def count(self) -> int:
        """S."""
        return len(self.low)
