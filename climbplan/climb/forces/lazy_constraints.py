"""Constraints on forces that are added lazily: commands, penetration, stability.

Few instants come close to them, so that they are added only where an answer violates them. All are
linear in the forces. A joint command is theta - D f, which has to stay within joint bounds and,
where required, put the toe inside its surface. For a body motion v of unit elastic stiffness, the
stiffness under load is 1 - g(v) . f (`stiffness_lost`). Stability is a linear matrix inequality,
which is enforced by cutting planes for the violating motions. Clarabel takes it directly
(`build_stability_cone`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.statement import (
    COMMAND_MARGIN,
    ForceStatement,
    compute_bound_violation,
    compute_penetration_shortfall,
    reduce_margin,
)
from climbplan.mechanics.stability import loaded_stiffness, stiffness_lost, stiffness_lost_matrices

_CUT_MARGIN = 1e-3  # of the elastic stiffness: cuts ask for this much more than is needed
_TOLERANCE = 1e-9  # [rad, m] by which commands may enter their reserve or miss their depth


@dataclass(frozen=True)
class ForceRows:
    """Rows A f <= upper on the forces of some instants."""

    A: Array  # (B, e, N, 3) [1/N]
    upper: Array  # (B, e)

    def select_limbs(self, limb: IntArray) -> Array:
        """Return the columns (B, e, n, 3) of the limbs (B, n) in contact."""
        return np.take_along_axis(self.A, limb[:, None, :, None], axis=2)

    def append_rows(self, following: ForceRows) -> ForceRows:
        """Return these rows, followed by further ones of the same instants."""
        return ForceRows(
            np.concatenate([self.A, following.A], axis=1),
            np.concatenate([self.upper, following.upper], axis=1),
        )


def pack_triangle(matrices: Array) -> Array:
    """Return upper triangles (..., 21) of symmetric matrices (..., 6, 6), in Clarabel's layout.

    Entries are column by column, with a factor on off-diagonal ones that preserves inner products.
    """
    column, row = np.tril_indices(6)
    scaling = np.where(column == row, 1.0, np.sqrt(2.0))
    return np.asarray(matrices[..., row, column] * scaling)


def build_stability_cone(statement: ForceStatement, instants: IntArray) -> ForceRows:
    """Return rows (B, 21, N, 3) for which upper - A f is positive semidefinite: stability."""
    if (statement.min_stiffness_ratio[instants] == -np.inf).any():
        shape = (len(instants), 0, *statement.contact.shape[1:], 3)
        return ForceRows(np.zeros(shape), np.zeros(shape[:2]))
    stiffness_loss = pack_triangle(
        stiffness_lost_matrices(statement.braced_body, instants)
    )  # (B, N, 3, 21)
    upper = (1.0 - statement.min_stiffness_ratio[instants, None]) * pack_triangle(np.eye(6))
    return ForceRows(np.moveaxis(stiffness_loss, -1, 1), upper)


class LazyConstraints:
    """The constraints found to be violated so far, instant by instant.

    reserve: [rad] that commands keep from joint bounds, as far as the bounds leave it.
    """

    def __init__(self, statement: ForceStatement, reserve: float = COMMAND_MARGIN) -> None:
        self.statement = statement
        self.reserve = reserve
        self._cuts: dict[int, list[Array]] = {}  # (N, 3) share of the stiffness lost per newton

    def find_violations(self, force: Array) -> IntArray:
        """Return instants whose forces (K, N, 3) violate a constraint, and store their stability
        cuts.
        """
        unstable = self._add_stability_cuts(force)
        bound_violation = compute_bound_violation(self.statement, force, self.reserve).max(
            axis=(1, 2)
        )
        penetration_shortfall = compute_penetration_shortfall(self.statement, force).max(axis=1)
        is_violated = np.maximum(bound_violation, penetration_shortfall) > _TOLERANCE
        return np.union1d(unstable, np.flatnonzero(is_violated))

    def _add_stability_cuts(self, force: Array) -> IntArray:
        """Return instants with too little stiffness; store the cuts of their weakest motions."""
        if (self.statement.min_stiffness_ratio == -np.inf).all():
            return np.empty(0, np.int64)
        stiffness = loaded_stiffness(self.statement.braced_body, force)
        buckling = np.flatnonzero(stiffness.left < self.statement.min_stiffness_ratio)
        direction = stiffness.direction[buckling]
        stiffness_loss = stiffness_lost(self.statement.braced_body, buckling, direction)
        for k, row in zip(buckling, stiffness_loss, strict=True):
            self._cuts.setdefault(int(k), []).append(row)
        return buckling

    def build_command_rows(self, instants: IntArray) -> ForceRows:
        """Return rows that keep the commands of some instants within bounds, down and up."""
        b, n = len(instants), self.statement.contact.shape[1]
        rows = self.statement.max_torque.size
        bending = self.statement.deflection_per_force[instants].reshape(b, rows, n, 3)
        margins = [self.statement.margin_below[instants], self.statement.margin_above[instants]]
        upper = reduce_margin(np.concatenate(margins, axis=1).reshape(b, 2 * rows), self.reserve)
        return ForceRows(np.concatenate([bending, -bending], axis=1), upper)

    def build_penetration_rows(self, instants: IntArray) -> ForceRows:
        """Return rows that keep commanded toes as deep inside their surfaces as required."""
        min_penetration = self.statement.min_penetration[instants]
        if (min_penetration == -np.inf).all():
            shape = (len(instants), 0, *self.statement.arms.shape[1:])
            return ForceRows(np.zeros(shape), np.zeros(shape[:2]))
        is_required = self.statement.standing[instants] & (min_penetration > -np.inf)
        # Rows of limbs in the air, and where nothing is asked, are zero and idle
        rows = -self.statement.penetration_per_force[instants] * is_required[..., None, None]
        return ForceRows(rows, np.where(is_required, -min_penetration, 1.0))

    def collect_cuts(self, instants: IntArray) -> ForceRows:
        """Return the stability cuts of some instants, padded with idle rows to equal numbers."""
        n = self.statement.contact.shape[1]
        max_cuts = max((len(self._cuts.get(int(k), [])) for k in instants), default=0)
        A = np.zeros((len(instants), max_cuts, n, 3))
        for instant_row, k in enumerate(instants):
            for row, cut in enumerate(self._cuts.get(int(k), [])):
                A[instant_row, row] = cut
        max_loss = 1.0 - self.statement.min_stiffness_ratio[instants] - _CUT_MARGIN
        max_loss = np.where(np.isfinite(max_loss), max_loss, 1.0)  # idle: none were found
        return ForceRows(A, np.tile(max_loss[:, None], (1, max_cuts)))
