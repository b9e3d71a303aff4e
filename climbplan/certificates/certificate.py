"""What proves a lower bound, or that nothing is feasible: a tree whose leaves have multipliers.

The tree splits the box of v, the variables of `rows.StatedRows`, so that its leaves cover
everything whoever made it; the multipliers of a leaf give a Lagrangian that bounds the cost of
every point in it. How they were found is of no concern to whoever checks them.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Certificate:
    """A proof about an instance: T nodes of a tree, S of them leaves, both in preorder.

    The lower side of a split comes first. Integers have v <= at on it and v >= at + 1 on the other
    side, all others v <= at and v >= at.
    """

    split: IntArray  # (T,) the variable that a node splits, -1 for a leaf
    at: Array  # (T,)
    point: Array  # (S, n) where the cost is linearised
    multiplier: sparse.csr_matrix  # (S, rows + 4 K) positive: of lower sides, negative: upper ones
    ball: Array  # (S, D) multiplier times direction
    empty: BoolArray  # (S,) the multipliers prove that the leaf has no point
    bound: float  # what the leaves prove together, infinite if nothing is feasible
