"""Null-space elimination: forces of n contacts in equilibrium are f = f0 + Z y.

Of an instant's 61 variables x = (s, y) remains, with 3 n - 6 unknowns y, or one more for collinear
contacts. Arrays are assembled for all instants of equally many contacts at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.statement import ForceStatement, sum_over_limb_points
from climbplan.mechanics.equilibrium import balance_load
from climbplan.mechanics.friction import contact_frame, project_to_cone, pyramid_rows

# A linear objective leaves forces open wherever they do not matter to the worst joint. Among
# equally good ones this weight, on half the sum of squared limb deflections |C f|^2 over BEND^2,
# picks those for which the limbs bend least, which makes the answer unique. Below a threshold such
# a term leaves the optimum of a linear program where it is; measured, it costs 1e-9 of the optimum.
PREFERENCE = 1e-6
DEFLECTION_SCALE = 0.1  # [m]
_REGULARISATION = 1e-2  # part of PREFERENCE on y itself, for limbs that are stiff in some direction
BALANCE_TOLERANCE = 1e-9  # load that contacts in a line may leave unbalanced, relative


@dataclass(frozen=True)
class ReducedForces:
    """The force problems of B instants with n contacts each, in units of the load.

    The variables are x = (s, y), with q unknowns y.
    """

    instant: IntArray  # (B,) rows of the statement
    limb: IntArray  # (B, n) points in contact
    particular: Array  # (B, n, 3) f0
    null_space: Array  # (B, n, 3, q) Z
    torque_particular: Array  # (B, l, J) torque / limit of f0, of l limbs in contact
    torque_null_space: Array  # (B, l, J, q) torque / limit of Z
    normal: Array  # (B, n, 3)
    frame_particular: Array  # (B, n, 3) f0 along normal, tangent, bitangent
    frame_null_space: Array  # (B, n, 3, q) Z likewise
    usable_mu: Array  # (B, n) mu / S_mu
    gradient: Array  # (B, q + 1) of s - w sum n . f
    preference: Array  # (B, q + 1, q + 1) Hessian of the preference for small deflections
    preference_gradient: Array  # (B, q + 1) its gradient at x = 0
    extra_rows: Array  # (B, e, q) further rows A y <= further_upper
    extra_upper: Array  # (B, e)
    stability: Array  # (B, 21 or 0, q) stability_upper - A y is a semidefinite matrix's triangle
    stability_upper: Array  # (B, 21 or 0)
    min_normal_force: Array  # (B,) of every contact
    reserve: Array  # (B,) pressure that each may miss before it slips
    max_s: Array  # (B,)
    unit: float  # [N]

    @property
    def num_contacts(self) -> int:
        """Return the number n of points in contact."""
        return self.limb.shape[1]

    @property
    def num_unknowns(self) -> int:
        """Return the number q of unknowns."""
        return self.null_space.shape[-1]

    def take(self, rows: IntArray) -> ReducedForces:
        """Return the same problem for some of the instants."""
        arrays = {name: value[rows] for name, value in vars(self).items() if np.ndim(value)}
        return replace(self, **arrays)

    def with_rows(self, A: Array, upper: Array) -> ReducedForces:
        """Return the same problem with rows A f <= upper on the forces, (B, e, n, 3) per newton."""
        rows, upper = self._map_to_unknowns(A, upper)
        return replace(self, extra_rows=rows, extra_upper=upper)

    def with_stability(self, A: Array, upper: Array) -> ReducedForces:
        """Return the same problem with upper - A f, (B, 21, n, 3) per newton, semidefinite."""
        rows, upper = self._map_to_unknowns(A, upper)
        return replace(self, stability=rows, stability_upper=upper)

    def _map_to_unknowns(self, A: Array, upper: Array) -> tuple[Array, Array]:
        """Return rows on the forces as rows on the unknowns."""
        A = self.unit * A.reshape(*A.shape[:2], 3 * self.num_contacts)
        b, size = len(A), A.shape[-1]
        particular = (A @ self.particular.reshape(b, size, 1))[..., 0]
        return A @ self.null_space.reshape(b, size, -1), upper - particular

    def compute_forces(self, y: Array) -> Array:
        """Return forces (B, n, 3) [N] for unknowns (B, q), projected into the friction cones.

        A contact may carry a thousandth of the load. Rounding that is negligible against the load
        is large against its own friction cone, so that rounding is moved into equilibrium.
        """
        force = self.particular + np.einsum("bniq,bq->bni", self.null_space, y)
        safe_mu = self.usable_mu * (1 - 1e-12)
        return self.unit * project_to_cone(force, self.normal, safe_mu)


@dataclass(frozen=True)
class ForceReduction:
    """All instants, reduced, and those whose contacts cannot balance the load at all."""

    groups: tuple[ReducedForces, ...]
    unbalanced: IntArray  # instants


def reduce_forces(statement: ForceStatement) -> ForceReduction:
    """Eliminate equilibrium from the force problems of all instants."""
    num_contacts = statement.contact.sum(axis=1)
    groups: list[ReducedForces] = []
    unbalanced: list[IntArray] = []
    for n in np.unique(num_contacts):
        rows = np.flatnonzero(num_contacts == n)
        # Instants with the same limbs in contact follow each other: they resemble each other.
        contact_order = np.lexsort((rows, *statement.contact[rows].T))
        rows = rows[contact_order]
        limbs = np.nonzero(statement.contact[rows])[1].reshape(len(rows), n)
        if n == 0:
            unbalanced.append(rows[np.any(statement.load[rows] != 0, axis=1)])
            continue
        arms = np.take_along_axis(statement.arms[rows], limbs[..., None], axis=1)
        load = statement.load[rows] / statement.unit
        for group_rows, balance in balance_load(arms, load, statement.length):
            is_balanced = balance.residual <= BALANCE_TOLERANCE
            unbalanced.append(rows[group_rows[~is_balanced]])
            balanced_rows = group_rows[is_balanced]
            if len(balanced_rows):
                particular = balance.particular[is_balanced].reshape(len(balanced_rows), n, 3)
                null_space = balance.null_space[is_balanced].reshape(len(balanced_rows), n, 3, -1)
                groups.append(
                    _reduce_group(
                        statement, rows[balanced_rows], limbs[balanced_rows], particular, null_space
                    )
                )
    no_instants = np.empty(0, np.int64)
    return ForceReduction(tuple(groups), np.sort(np.concatenate([no_instants, *unbalanced])))


def _reduce_group(
    statement: ForceStatement, rows: IntArray, limbs: IntArray, particular: Array, null_space: Array
) -> ReducedForces:
    """Assemble the reduced problems of instants with equally many contacts."""
    contact_index = (rows[:, None], limbs)
    axes = contact_frame(statement.normal[contact_index]).axes
    frame_null_space = axes @ null_space
    torque = statement.torque_per_force[contact_index] * statement.unit
    b, n, q = len(rows), limbs.shape[1], null_space.shape[-1]
    points = statement.points
    gradient = np.ones((b, q + 1))
    gradient[:, 1:] = frame_null_space[:, :, 0].sum(axis=1)
    gradient[:, 1:] *= -statement.normal_force_weight * statement.unit
    scaled_compliance = statement.compliance[contact_index] * (statement.unit / DEFLECTION_SCALE)
    deflected_particular = (scaled_compliance @ particular[..., None]).reshape(b, 3 * n, 1)
    deflected_null_space = (scaled_compliance @ null_space).reshape(b, 3 * n, q)
    transposed = PREFERENCE * np.swapaxes(deflected_null_space, 1, 2)
    preference = np.zeros((b, q + 1, q + 1))
    preference[:, 1:, 1:] = transposed @ deflected_null_space
    preference += PREFERENCE * _REGULARISATION * np.eye(q + 1)
    preference_gradient = np.zeros((b, q + 1))
    preference_gradient[:, 1:] = (transposed @ deflected_particular)[..., 0]
    return ReducedForces(
        instant=rows,
        limb=limbs,
        particular=particular,
        null_space=null_space,
        torque_particular=sum_over_limb_points(
            np.einsum("bnij,bnj->bni", torque, particular), points
        )
        + statement.link_torque_ratio[rows[:, None], limbs[:, ::points] // points],
        torque_null_space=sum_over_limb_points(torque @ null_space, points),
        normal=axes[:, :, 0],
        frame_particular=(axes @ particular[..., None])[..., 0],
        frame_null_space=frame_null_space,
        usable_mu=statement.usable_mu[contact_index],
        gradient=gradient,
        preference=preference,
        preference_gradient=preference_gradient,
        extra_rows=np.empty((b, 0, q)),
        extra_upper=np.empty((b, 0)),
        stability=np.empty((b, 0, q)),
        stability_upper=np.empty((b, 0)),
        min_normal_force=statement.min_normal_force[rows] / statement.unit,
        reserve=statement.reserve[rows] / statement.unit,
        max_s=statement.max_s[rows],
        unit=statement.unit,
    )


@dataclass(frozen=True)
class ReducedHalfspaces:
    """Linear rows A x <= upper of B instants, in addition to 0 <= s <= max_s.

    Rows: 2 J l of torque (positive, then negative), n of contact, n F of friction, and the extra
    rows of the group.
    """

    A: Array  # (B, m, q + 1)
    upper: Array  # (B, m)
    num_contacts: int  # n
    num_facets: int  # F
    num_torques: int  # J l

    @property
    def contact(self) -> slice:
        """Return the slice of the contact rows: those after the 2 J l of torque."""
        start = 2 * self.num_torques
        return slice(start, start + self.num_contacts)

    @property
    def friction(self) -> slice:
        """Return the slice of the friction rows, after the 2 J l + n of torque and contact."""
        start = 2 * self.num_torques + self.num_contacts
        return slice(start, start + self.num_contacts * self.num_facets)


def build_halfspaces(
    group: ReducedForces, corners: Array | None = None, facets: int = 0
) -> ReducedHalfspaces:
    """Return torque and contact rows, and friction rows for polygons with `corners` (B, n, F)
    [rad].

    Without corners the friction rows are zero, for `write_friction_rows`.
    """
    b, n, q = len(group.instant), group.num_contacts, group.num_unknowns
    facets = facets if corners is None else corners.shape[-1]
    num_torques = group.torque_particular[0].size  # torques in one direction
    m = 2 * num_torques + n * (1 + facets)
    A = np.zeros((b, m + group.extra_rows.shape[1], q + 1))
    upper = np.zeros((b, m + group.extra_rows.shape[1]))
    # Torque: +-(T f0 + T Z y) - s <= 0
    A[:, : 2 * num_torques, 0] = -1.0
    A[:, :num_torques, 1:] = group.torque_null_space.reshape(b, num_torques, q)
    np.negative(A[:, :num_torques, 1:], out=A[:, num_torques : 2 * num_torques, 1:])
    upper[:, num_torques : 2 * num_torques] = group.torque_particular.reshape(b, num_torques)
    np.negative(upper[:, num_torques : 2 * num_torques], out=upper[:, :num_torques])
    # Contact: -n . (f0 + Z y) <= -least pressure
    np.negative(
        group.frame_null_space[:, :, 0], out=A[:, 2 * num_torques : 2 * num_torques + n, 1:]
    )
    upper[:, 2 * num_torques : 2 * num_torques + n] = (
        group.frame_particular[:, :, 0] - group.min_normal_force[:, None]
    )
    A[:, m:, 1:], upper[:, m:] = group.extra_rows, group.extra_upper
    rows = ReducedHalfspaces(A, upper, n, facets, num_torques)
    if corners is not None:
        write_friction_rows(group, rows, corners)
    return rows


def write_friction_rows(group: ReducedForces, rows: ReducedHalfspaces, corners: Array) -> None:
    """Write the friction rows of polygons with `corners` (B, n, F) into `rows`."""
    b, n, q = len(group.instant), group.num_contacts, group.num_unknowns
    facet_rows = pyramid_rows(group.usable_mu, corners)  # (B, n, F, 3)
    rows.A[:, rows.friction, 1:] = (facet_rows @ group.frame_null_space).reshape(
        b, n * rows.num_facets, q
    )
    reserved = group.frame_particular.copy()
    reserved[..., 0] -= group.reserve[:, None]  # the cone begins where the reserve ends
    rows.upper[:, rows.friction] = -(facet_rows @ reserved[..., None]).reshape(b, -1)
