"""Lower bounds on the gain of a relaxation's bound by a violated row, without solving it.

Let multipliers l be optimal for the active rows A. One step of a dual method adds a violated row p:
l_p = t, l_A = l_A - t r. For a violation v the dual function rises by t v - 1/2 t^2 |p - A'r|^2.
This gain is valid for every r as long as no multiplier changes its sign. r = 0 and the projection
onto the active rows are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.tree.cost_scaling import ScaledCost

_RIDGE = 1e-10  # keeps nearly dependent active rows solvable; the gain stays exact
_SMALL = 1e-14


@dataclass(frozen=True)
class DualSteps:
    """Dual step data of some rows; far means projected onto the active rows, near r = 0."""

    near: Array  # (P,) |p|^2 over curved coordinates
    far: Array  # (P,) |p - A'r|^2
    step: Array  # (2, P) longest steps at the upper and the lower bound
    near_drag: Array  # (2, P) loss of slope in flat coordinates
    far_drag: Array  # (2, P)

    def select(self, rows: IntArray) -> DualSteps:
        """Return the data of some of the rows, for any shape of indices."""
        return DualSteps(
            self.near[rows],
            self.far[rows],
            self.step[:, rows],
            self.near_drag[:, rows],
            self.far_drag[:, rows],
        )

    def compute_gain(self, value: Array, lower: Array, upper: Array) -> Array:
        """Return the largest gain of any row whose value leaves its bounds, over the last axis."""
        best = np.zeros(())
        for side, violation in enumerate((value - upper, lower - value)):
            v = np.maximum(violation - self.far_drag[side], 0.0)
            step = np.minimum(v / np.maximum(self.far, _SMALL), self.step[side])
            far = step * v - 0.5 * step**2 * self.far
            v = np.maximum(violation - self.near_drag[side], 0.0)
            curved_step = 0.5 * v**2 / np.maximum(self.near, _SMALL)
            best = np.maximum(best, np.maximum(far, curved_step).max(axis=-1, initial=0.0))
        return best


def compute_dual_steps(
    rows: Array, active: Array, multiplier: Array, fixed: BoolArray, z: Array, cost: ScaledCost
) -> DualSteps:
    """Compute the dual steps of rows at a relaxation's solution.

    Args:
        rows: (P, k) rows.
        active: (a, k) active rows.
        multiplier: (a,) their multipliers.
        fixed: (a,) mask of equations, whose multipliers may take either sign.
        z: (k,) solution.
        cost: Scaled cost.
    """
    no_drag = np.zeros((2, len(rows)))
    curved, near_drag = _split_curved(rows, z, cost)
    if not len(active):
        return DualSteps(curved, curved, no_drag, near_drag, near_drag)
    gram = active @ active.T
    gram[np.diag_indices(len(gram))] *= 1.0 + _RIDGE
    r = np.linalg.solve(gram, active @ rows.T)  # (a, P)
    far, far_drag = _split_curved(rows - r.T @ active, z, cost)
    # At the upper bound the multipliers become l - t r: they keep their sign while t r / l <= 1.
    relative_change = np.where(fixed[:, None], 0.0, r / multiplier[:, None])
    step = np.stack([relative_change.max(axis=0), (-relative_change).max(axis=0)])
    return DualSteps(curved, far, 1.0 / np.maximum(step, 1e-300), near_drag, far_drag)


def _split_curved(rows: Array, z: Array, cost: ScaledCost) -> tuple[Array, Array]:
    """Return squared lengths over curved coordinates, and what flat ones take off a violation.

    Along a flat coordinate the Lagrangian is linear: its minimum over |z| <= extent is extent |p| +
    p z below the value at z.
    """
    if not len(cost.flat):
        return np.einsum("pk,pk->p", rows, rows), np.zeros((2, len(rows)))
    flat = rows[:, cost.flat]
    square = np.einsum("pk,pk->p", rows, rows) - np.einsum("pk,pk->p", flat, flat)
    with np.errstate(invalid="ignore"):
        spread = np.nan_to_num(np.abs(flat) * cost.extent[cost.flat], nan=0.0, posinf=np.inf)
    value_at_z = flat @ z[cost.flat]
    return square, np.stack([spread.sum(axis=1) + value_at_z, spread.sum(axis=1) - value_at_z])
