"""What a block answers: its copy of the positions, and the modes that integers mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.columns import Columns
from climbplan.limms.consensus.setting import Setting
from climbplan.program.residuals import BlockResidual


@dataclass(frozen=True)
class Copy:
    """Positions as one block has them: box (K + 1, 3) and modules (K + 1, L, 5, 3) [m]."""

    box: Array
    points: Array

    def moved(self, other: Copy, factor: float) -> Copy:
        """This plus a factor times the other."""
        return Copy(self.box + factor * other.box, self.points + factor * other.points)

    def scaled(self, factor: float) -> Copy:
        """All of it times a factor."""
        return Copy(self.box * factor, self.points * factor)


@dataclass(frozen=True)
class Modes:
    """The integers, by what they mean; as in `Columns`."""

    box: IntArray  # (K,) mode of the box
    drives: IntArray  # (L, K)
    leg: IntArray  # (L, K)
    hold: IntArray  # (L, K) side of the box that an arm holds, -1 none
    mount: IntArray  # (L, K) side of the box that a leg carries
    wall: IntArray  # (L, K) anchor of the terrain
    parent: IntArray  # (L, K) module that an added arm is on
    ground: IntArray  # (L, K) patch that the first end stands on
    region: IntArray  # (K + 1, L, 4) free block of each link


@dataclass(frozen=True)
class Found:
    """An answer of the block."""

    status: str  # "optimal", "limit" or "infeasible"
    copy: Copy | None
    modes: Modes | None
    velocity: Array | None  # (K + 1, 3) of the box [m/s]
    missed: float  # [m] of the goal
    seconds: float
    x: Array | None
    off: BlockResidual | None = None  # the block of rows that x is furthest off


def modes_of(setting: Setting, c: Columns, x: Array) -> Modes:
    """What the integers of a point mean."""

    def chosen(columns: IntArray) -> IntArray:
        values = np.round(x[columns]).astype(int)
        if not len(values):
            return np.full(values.shape[1:], -1)
        return np.where(values.any(axis=0), values.argmax(axis=0), -1)

    region = chosen(c.region)  # (4, L, K + 1)
    return Modes(
        box=chosen(c.box),
        drives=np.round(x[c.drives]).astype(int),
        leg=np.round(x[c.leg]).astype(int),
        hold=chosen(c.hold),
        mount=chosen(c.mount),
        wall=chosen(c.wall),
        parent=chosen(c.carry),
        ground=chosen(c.ground),
        region=np.maximum(np.moveaxis(region, 2, 0).swapaxes(1, 2), 0),
    )
