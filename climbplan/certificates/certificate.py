"""Certificates of lower bounds and of infeasibility: trees whose leaves have multipliers.

The tree splits the box of v, the variables of `rows.StatedRows`, so that its leaves cover it. The
multipliers of a leaf give a Lagrangian that bounds the cost of every point in the leaf. The checker
does not depend on how they were found.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Certificate:
    """A proof about an instance: T nodes of a tree, S of them leaves, both in preorder.

    The lower side of a split comes first. It has v <= at for all variables; the other side has v >=
    at + 1 for integers and v >= at for all others.
    """

    split: IntArray  # (T,) variable that a node splits, -1 for a leaf
    at: Array  # (T,)
    point: Array  # (S, n) where the cost is linearised
    multiplier: sparse.csr_matrix  # (S, rows + 4 K) positive for lower, negative for upper sides
    ball: Array  # (S, D) multiplier times direction
    empty: BoolArray  # (S,) whether the multipliers prove that the leaf is infeasible
    bound: float  # bound of all leaves together, infinite if nothing is feasible
