"""What a leg's arm and the body's height are partitioned into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.model import Lin


@dataclass(frozen=True)
class Piece:
    """One region and one part of a leg's arm at a knot, and what it holds if it is chosen."""

    region: int
    low: Array  # (2,) ends of the arm along the heading and across [m]
    high: Array
    chosen: Lin
    arm: tuple[Lin, Lin]
    force: tuple[Lin, Lin, Lin]  # in units of force
    by_x: tuple[Lin, Lin]  # arm_x f_y, arm_x f_z
    by_y: tuple[Lin, Lin]  # arm_y f_x, arm_y f_z

    def beyond(self, arm: Array) -> float:
        """How far an arm (3,), about the axes of the heading, is outside of its part [m]."""
        return float(np.maximum(self.low - arm[:2], arm[:2] - self.high).max())


@dataclass(frozen=True)
class Height:
    """Parts of the body's height at a knot: ends, and the binary of each."""

    low: Array
    high: Array
    chosen: tuple[Lin, ...]
