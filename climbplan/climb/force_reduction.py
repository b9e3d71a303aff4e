"""Elimination: forces of n contacts in equilibrium are f = f0 + Z y.

What is left of an instant's 61 variables is x = (s, y) with 3 n - 6 unknowns y, or one more for
contacts in a line. Everything is assembled for all instants of equally many contacts at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.force_statement import ForceStatement
from climbplan.mechanics.equilibrium import balance_load
from climbplan.mechanics.friction import ContactFrame, contact_frame, project_to_cone, pyramid_rows
from climbplan.plans.climb_plan import Array, Index, Mask

# Weight of |f|^2 / 2 (in units of the load) beside the objective. A linear objective leaves forces
# open wherever they do not matter to the worst joint; this picks the smallest of the optimal ones,
# which makes the answer unique. Below a threshold such a term leaves the optimum of a linear
# program where it is: its measured effect on the objective is below 1e-9, and never above
# PREFERENCE |f|^2 / 2.
PREFERENCE = 1e-4
BALANCE_TOLERANCE = 1e-9  # load that contacts in a line may leave unbalanced, relative


@dataclass(frozen=True)
class ReducedForces:
    """The force problems of B instants with n contacts each, in units of the load.

    x = (s, y), q unknowns y.
    """

    instant: Index  # (B,) rows of the statement
    limb: Index  # (B, n) limbs in contact
    particular: Array  # (B, n, 3) f0
    null_space: Array  # (B, n, 3, q) Z
    torque_particular: Array  # (B, n, 3) torque / limit of f0
    torque_null_space: Array  # (B, n, 3, q) torque / limit of Z
    frame: ContactFrame  # (B, n, ...)
    usable_mu: Array  # (B, n) mu / S_mu
    gradient: Array  # (B, q + 1) of s - w sum n . f
    largest_s: float
    unit: float  # [N]

    @property
    def contacts(self) -> int:
        """n."""
        return self.limb.shape[1]

    @property
    def unknowns(self) -> int:
        """q."""
        return self.null_space.shape[-1]

    def take(self, rows: Index) -> ReducedForces:
        """The same problem for some of the instants."""
        frame = ContactFrame(
            self.frame.normal[rows], self.frame.tangent[rows], self.frame.bitangent[rows]
        )
        return ReducedForces(
            self.instant[rows],
            self.limb[rows],
            self.particular[rows],
            self.null_space[rows],
            self.torque_particular[rows],
            self.torque_null_space[rows],
            frame,
            self.usable_mu[rows],
            self.gradient[rows],
            self.largest_s,
            self.unit,
        )

    def forces(self, y: Array) -> Array:
        """Forces (B, n, 3) [N] for unknowns (B, q), their last rounding taken out of friction.

        A contact may carry a thousandth of the load; rounding that is nothing against the load is
        much against its own friction cone, so rounding is moved into equilibrium.
        """
        force = self.particular + np.einsum("bniq,bq->bni", self.null_space, y)
        safe = self.usable_mu * (1 - 1e-12)
        return self.unit * project_to_cone(force, self.frame.normal, safe)


@dataclass(frozen=True)
class Reduction:
    """All instants, reduced, and those whose contacts cannot balance the load at all."""

    groups: tuple[ReducedForces, ...]
    unbalanced: Index  # instants


def reduce_forces(statement: ForceStatement) -> Reduction:
    """Eliminate equilibrium from the force problems of all instants."""
    count = statement.contact.sum(axis=1)
    groups: list[ReducedForces] = []
    unbalanced: list[Index] = []
    for n in np.unique(count):
        rows = np.flatnonzero(count == n)
        # Instants with the same limbs in contact follow each other: they resemble each other.
        pattern = np.lexsort((rows, *statement.contact[rows].T))
        rows = rows[pattern]
        limbs = np.nonzero(statement.contact[rows])[1].reshape(len(rows), n)
        if n == 0:
            unbalanced.append(rows[np.any(statement.load[rows] != 0, axis=1)])
            continue
        arms = np.take_along_axis(statement.arms[rows], limbs[..., None], axis=1)
        load = statement.load[rows] / statement.unit
        for at, balance in balance_load(arms, load, statement.length):
            holds = balance.residual <= BALANCE_TOLERANCE
            unbalanced.append(rows[at[~holds]])
            kept = at[holds]
            if len(kept):
                particular = balance.particular[holds].reshape(len(kept), n, 3)
                null_space = balance.null_space[holds].reshape(len(kept), n, 3, -1)
                groups.append(_reduced(statement, rows[kept], limbs[kept], particular, null_space))
    none = np.empty(0, np.int64)
    return Reduction(tuple(groups), np.sort(np.concatenate([none, *unbalanced])))


def _reduced(
    statement: ForceStatement, rows: Index, limbs: Index, particular: Array, null_space: Array
) -> ReducedForces:
    at = (rows[:, None], limbs)
    normal = statement.normal[at]
    torque = statement.torque_per_force[at] * statement.unit
    gradient = np.ones((len(rows), null_space.shape[-1] + 1))
    gradient[:, 1:] = np.einsum("bni,bniq->bq", normal, null_space)
    gradient[:, 1:] *= -statement.normal_force_weight * statement.unit
    return ReducedForces(
        instant=rows,
        limb=limbs,
        particular=particular,
        null_space=null_space,
        torque_particular=np.einsum("bnij,bnj->bni", torque, particular),
        torque_null_space=torque @ null_space,
        frame=contact_frame(normal),
        usable_mu=statement.usable_mu[at],
        gradient=gradient,
        largest_s=statement.largest_s,
        unit=statement.unit,
    )


@dataclass(frozen=True)
class Halfspaces:
    """Linear rows A x <= upper of B instants, beside 0 <= s <= largest_s.

    Rows: 6 n of torque (positive, then negative), n of contact, n F of friction.
    """

    A: Array  # (B, m, q + 1)
    upper: Array  # (B, m)
    facets: int  # F


def halfspaces(group: ReducedForces, corners: Array | None = None, facets: int = 0) -> Halfspaces:
    """Torque and contact rows, and friction rows for polygons with `corners` (B, n, F) [rad].

    Without corners the friction rows are left at zero for `set_friction`.
    """
    b, n, q = len(group.instant), group.contacts, group.unknowns
    facets = facets if corners is None else corners.shape[-1]
    A = np.zeros((b, n * (7 + facets), q + 1))
    upper = np.zeros((b, n * (7 + facets)))
    # Torque: +-(T f0 + T Z y) - s <= 0
    A[:, : 6 * n, 0] = -1.0
    A[:, : 3 * n, 1:] = group.torque_null_space.reshape(b, 3 * n, q)
    np.negative(A[:, : 3 * n, 1:], out=A[:, 3 * n : 6 * n, 1:])
    upper[:, 3 * n : 6 * n] = group.torque_particular.reshape(b, 3 * n)
    np.negative(upper[:, 3 * n : 6 * n], out=upper[:, : 3 * n])
    # Contact: -n . (f0 + Z y) <= 0
    normal = group.frame.normal[:, :, None]
    A[:, 6 * n : 7 * n, 1:] = -(normal @ group.null_space)[:, :, 0]
    upper[:, 6 * n : 7 * n] = (group.frame.normal * group.particular).sum(axis=-1)
    rows = Halfspaces(A, upper, facets)
    if corners is not None:
        set_friction(group, rows, corners)
    return rows


def set_friction(group: ReducedForces, rows: Halfspaces, corners: Array) -> None:
    """Write the friction rows of polygons with `corners` (B, n, F) into `rows`."""
    b, n, q = len(group.instant), group.contacts, group.unknowns
    facet = pyramid_rows(group.frame, group.usable_mu, corners)  # (B, n, F, 3)
    rows.A[:, 7 * n :, 1:] = (facet @ group.null_space).reshape(b, n * rows.facets, q)
    rows.upper[:, 7 * n :] = -np.einsum("bnfi,bni->bnf", facet, group.particular).reshape(b, -1)


def active_rows(rows: Halfspaces, multipliers: Array) -> Mask:
    """(B, m) rows with a multiplier."""
    return np.asarray(np.abs(multipliers) > 0)
