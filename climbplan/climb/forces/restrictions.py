"""Restrictions on forces that few instants come close to: commands, stability.

They are added where an answer without them does not hold, which leaves optima what they are. All
are linear in the forces: a joint command is theta - D f, which is to stay within joint bounds and,
where asked, to put the toe inside its surface, and for a body motion v of unit elastic
stiffness what forces leave of the stiffness is 1 - g(v) . f (`stiffness_lost`). The motions that
matter are found as needed, so that stability, a matrix inequality, is kept by cutting planes;
Clarabel takes it as it is (`stability_cone`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.statement import (
    COMMAND_RESERVE,
    ForceStatement,
    beyond_bounds,
    depth_missing,
    kept,
)
from climbplan.mechanics.stability import loaded_stiffness, stiffness_lost, stiffness_lost_matrices

_STIFFNESS_RESERVE = 1e-3  # of the elastic stiffness: cuts ask for this much more than is needed
_TOLERANCE = 1e-9  # [rad, m] by which commands may enter their reserve or miss their depth


@dataclass(frozen=True)
class Rows:
    """Rows A f <= upper on the forces of some instants."""

    A: Array  # (B, e, N, 3) [1/N]
    upper: Array  # (B, e)

    def of_limbs(self, limb: IntArray) -> Array:
        """(B, e, n, 3) columns of the limbs (B, n) in contact."""
        return np.take_along_axis(self.A, limb[:, None, :, None], axis=2)

    def and_also(self, more: Rows) -> Rows:
        """These rows, then more of the same instants."""
        return Rows(
            np.concatenate([self.A, more.A], axis=1),
            np.concatenate([self.upper, more.upper], axis=1),
        )


def triangle(matrices: Array) -> Array:
    """Upper triangles (..., 21) of symmetric (..., 6, 6), as Clarabel's semidefinite cone has them.

    Column by column, with a factor that keeps inner products.
    """
    column, row = np.tril_indices(6)
    factor = np.where(column == row, 1.0, np.sqrt(2.0))
    return np.asarray(matrices[..., row, column] * factor)


def stability_cone(statement: ForceStatement, instants: IntArray) -> Rows:
    """Rows (B, 21, N, 3) for which upper - A f is a positive semidefinite matrix: stability."""
    if (statement.stiffness_left[instants] == -np.inf).any():
        shape = (len(instants), 0, *statement.contact.shape[1:], 3)
        return Rows(np.zeros(shape), np.zeros(shape[:2]))
    lost = triangle(stiffness_lost_matrices(statement.braced, instants))  # (B, N, 3, 21)
    kept_part = (1.0 - statement.stiffness_left[instants, None]) * triangle(np.eye(6))
    return Rows(np.moveaxis(lost, -1, 1), kept_part)


class Restrictions:
    """The restrictions found to matter so far, instant by instant.

    reserve: [rad] that commands keep from joint bounds, as far as there is room for it.
    """

    def __init__(self, statement: ForceStatement, reserve: float = COMMAND_RESERVE) -> None:
        self.statement = statement
        self.reserve = reserve
        self._cuts: dict[int, list[Array]] = {}  # (N, 3) share of the stiffness lost per newton

    def broken_by(self, force: Array) -> IntArray:
        """Instants whose forces (K, N, 3) break a restriction; its cuts are remembered."""
        buckling = self._cut(force)
        beyond = beyond_bounds(self.statement, force, self.reserve).max(axis=(1, 2))
        shallow = depth_missing(self.statement, force).max(axis=1)
        broken = np.maximum(beyond, shallow) > _TOLERANCE
        return np.union1d(buckling, np.flatnonzero(broken))

    def _cut(self, force: Array) -> IntArray:
        """Instants that forces leave too little stiffness; the motions that tell are kept."""
        if (self.statement.stiffness_left == -np.inf).all():
            return np.empty(0, np.int64)
        stiffness = loaded_stiffness(self.statement.braced, force)
        buckling = np.flatnonzero(stiffness.left < self.statement.stiffness_left)
        direction = stiffness.direction[buckling]
        lost = stiffness_lost(self.statement.braced, buckling, direction)
        for k, row in zip(buckling, lost, strict=True):
            self._cuts.setdefault(int(k), []).append(row)
        return buckling

    def commands(self, instants: IntArray) -> Rows:
        """Rows that keep the commands of some instants within bounds, down and up."""
        b, n = len(instants), self.statement.contact.shape[1]
        rows = self.statement.max_torque.size
        bending = self.statement.bending[instants].reshape(b, rows, n, 3)
        room = [self.statement.room_below[instants], self.statement.room_above[instants]]
        upper = kept(np.concatenate(room, axis=1).reshape(b, 2 * rows), self.reserve)
        return Rows(np.concatenate([bending, -bending], axis=1), upper)

    def depths(self, instants: IntArray) -> Rows:
        """Rows that keep commanded toes as deep inside their surfaces as asked."""
        least = self.statement.least_depth[instants]
        if (least == -np.inf).all():
            shape = (len(instants), 0, *self.statement.arms.shape[1:])
            return Rows(np.zeros(shape), np.zeros(shape[:2]))
        asked = self.statement.standing[instants] & (least > -np.inf)
        # Rows of limbs in the air, and where nothing is asked, are zero and idle
        rows = -self.statement.inward[instants] * asked[..., None, None]
        return Rows(rows, np.where(asked, -least, 1.0))

    def cuts(self, instants: IntArray) -> Rows:
        """Cuts found for some instants; those with fewer than others get idle rows."""
        n = self.statement.contact.shape[1]
        most = max((len(self._cuts.get(int(k), [])) for k in instants), default=0)
        A = np.zeros((len(instants), most, n, 3))
        for place, k in enumerate(instants):
            for row, cut in enumerate(self._cuts.get(int(k), [])):
                A[place, row] = cut
        most_lost = 1.0 - self.statement.stiffness_left[instants] - _STIFFNESS_RESERVE
        most_lost = np.where(np.isfinite(most_lost), most_lost, 1.0)  # idle: none were found
        return Rows(A, np.tile(most_lost[:, None], (1, most)))
