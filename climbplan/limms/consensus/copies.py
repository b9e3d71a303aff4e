"""What a block answers: its copy of the positions, and the modes that integers mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.limms.consensus.columns import Columns
from climbplan.limms.consensus.setting import Setting
from climbplan.limms.scene import Array, Index
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

    box: Index  # (K,) mode of the box
    drives: Index  # (L, K)
    leg: Index  # (L, K)
    hold: Index  # (L, K) side of the box that an arm holds, -1 none
    mount: Index  # (L, K) side of the box that a leg carries
    wall: Index  # (L, K) anchor of the terrain
    parent: Index  # (L, K) module that an added arm is on
    ground: Index  # (L, K) patch that the first end stands on
    region: Index  # (K + 1, L, 4) free block of each link


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

    def chosen(columns: Index) -> Index:
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
