"""Solutions of the blocks: local copies of positions, and the modes that integers encode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.problem import ConsensusProblem
from climbplan.limms.consensus.variables import VariableColumns
from climbplan.program.residuals import BlockResidual


@dataclass(frozen=True)
class LocalCopy:
    """A local copy of the consensus variables: box (K + 1, 3) and modules (K + 1, L, 5, 3) [m]."""

    box: Array
    points: Array

    def add_scaled(self, direction: LocalCopy, factor: float) -> LocalCopy:
        """Return this copy plus a factor times another."""
        return LocalCopy(self.box + factor * direction.box, self.points + factor * direction.points)

    def scale(self, factor: float) -> LocalCopy:
        """Return this copy times a factor."""
        return LocalCopy(self.box * factor, self.points * factor)


@dataclass(frozen=True)
class Modes:
    """The integers of a solution, decoded; as in `VariableColumns`."""

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
class BlockSolution:
    """A solution of the mixed-integer block."""

    status: str  # "optimal", "limit" or "infeasible"
    copy: LocalCopy | None
    modes: Modes | None
    velocity: Array | None  # (K + 1, 3) of the box [m/s]
    goal_error: float  # [m] distance of the box from its goal at the end
    seconds: float
    x: Array | None
    worst_rows: BlockResidual | None = None  # the block of rows that x violates most


def decode_modes(problem: ConsensusProblem, c: VariableColumns, x: Array) -> Modes:
    """Return the modes that the integers of a point encode."""

    def find_chosen(columns: IntArray) -> IntArray:
        values = np.round(x[columns]).astype(int)
        if not len(values):
            return np.full(values.shape[1:], -1)
        return np.where(values.any(axis=0), values.argmax(axis=0), -1)

    region = find_chosen(c.region)  # (4, L, K + 1)
    return Modes(
        box=find_chosen(c.box),
        drives=np.round(x[c.drives]).astype(int),
        leg=np.round(x[c.leg]).astype(int),
        hold=find_chosen(c.hold),
        mount=find_chosen(c.mount),
        wall=find_chosen(c.wall),
        parent=find_chosen(c.carry),
        ground=find_chosen(c.ground),
        region=np.maximum(np.moveaxis(region, 2, 0).swapaxes(1, 2), 0),
    )
