"""The answer of a method for one scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from climbplan.arrays import Array, IntArray

Status = Literal["optimal", "feasible", "infeasible", "limit"]


@dataclass(frozen=True)
class Placement:
    """Poses and states of all books after the insertion, the inserted one last."""

    pose: Array  # (n + 1, 3) x [m], y [m], angle [rad]
    state: IntArray  # (n + 1,) of `BookState`
    slot: int  # stored books left of the inserted one


@dataclass(frozen=True)
class Shortage:
    """Missing width or height of a shelf for which no placement exists."""

    width: float  # [m] a shelf this much wider has a placement
    width_bound: float  # [m] one that is widened by this much has none: proved
    height: float  # [m] clear height that a book misses upright and flat; the widths are 0 then

    def __str__(self) -> str:
        if self.height > 0:
            return f"a book misses {1e3 * self.height:.2f} mm of clear height"
        return f"{1e3 * self.width:.2f} mm of width are missing"


@dataclass(frozen=True)
class SceneAnswer:
    """Status, placement and bound that a method returned for one scene."""

    status: Status  # `limit`: no placement found in time, `feasible`: found but the gap is open
    placement: Placement | None
    objective: float  # [mm^2] movement cost, infinite without a placement
    bound: float  # [mm^2] no placement costs less; minus infinity if the method proves nothing
    seconds: float
    nodes: int = 0  # of a tree, or iterations
    candidates: int = 0  # placements, or sets of integers, that were tried
    shortage: Shortage | None = None  # if infeasible
    message: str = ""  # why there is no placement, or what deserves a remark

    @property
    def gap(self) -> float:
        """Optimality gap: objective - bound [mm^2], infinite without a placement."""
        return self.objective - self.bound if math.isfinite(self.objective) else math.inf
