"""Partitions of moment arms and of the body's height, for piecewise McCormick envelopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.linear_model import LinExpr


@dataclass(frozen=True)
class ArmPiece:
    """One piece of a leg's moment arm on one region at a knot, with its binary.

    All expressions are zero if the piece is not selected.
    """

    region: int
    low: Array  # (2,) ends of the arm along the heading and across [m]
    high: Array
    indicator: LinExpr  # 1: the leg stands on the region with its arm in the piece
    arm: tuple[LinExpr, LinExpr]
    force: tuple[LinExpr, LinExpr, LinExpr]  # in units of force
    products_x: tuple[LinExpr, LinExpr]  # arm_x f_y, arm_x f_z
    products_y: tuple[LinExpr, LinExpr]  # arm_y f_x, arm_y f_z

    def compute_violation(self, arm: Array) -> float:
        """Return how far an arm (3,), about the heading axes, is outside of the piece [m]."""
        return float(np.maximum(self.low - arm[:2], arm[:2] - self.high).max())


@dataclass(frozen=True)
class HeightPartition:
    """The pieces of the body's height at a knot: their ends, and the binary of each."""

    low: Array
    high: Array
    indicators: tuple[LinExpr, ...]
