"""How much a violated row is sure to raise a relaxation's bound, without solving it.

From multipliers l that are optimal for the active rows A, one step of a dual method adds a violated
row p: l_p = t, l_A = l_A - t r. The dual function then rises by t v - 1/2 t^2 |p - A'r|^2 for a
violation v, which is a valid gain for every r as long as no multiplier changes its sign. r = 0 and
the projection onto the active rows are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.program.polytope import Array
from climbplan.solvers.result import Indices

_RIDGE = 1e-10  # keeps nearly dependent active rows solvable; the gain stays exact
_SMALL = 1e-14


@dataclass(frozen=True)
class RowRates:
    """Dual step data of some rows."""

    square: Array  # (P,) |p|^2
    projected: Array  # (P,) |p - A'r|^2
    step_up: Array  # (P,) longest step at the upper bound
    step_down: Array  # (P,) longest step at the lower bound

    def take(self, rows: Indices) -> RowRates:
        """The data of some of the rows, any shape of indices."""
        return RowRates(
            self.square[rows], self.projected[rows], self.step_up[rows], self.step_down[rows]
        )

    def gain(self, value: Array, lower: Array, upper: Array) -> Array:
        """Largest gain of any one row whose value leaves its bounds, over the last axis."""
        best = np.zeros(())
        for violation, longest in ((value - upper, self.step_up), (lower - value, self.step_down)):
            v = np.maximum(violation, 0.0)
            step = np.minimum(v / np.maximum(self.projected, _SMALL), longest)
            far = step * v - 0.5 * step**2 * self.projected
            near = 0.5 * v**2 / np.maximum(self.square, _SMALL)
            best = np.maximum(best, np.maximum(far, near).max(axis=-1, initial=0.0))
        return best


def plain_rates(rows: Array) -> RowRates:
    """Rates without projection: all multipliers stay."""
    square = np.einsum("pk,pk->p", rows, rows)
    none = np.zeros(len(rows))
    return RowRates(square, square, none, none)


def row_rates(rows: Array, active: Array, multiplier: Array, fixed: Array) -> RowRates:
    """Rates of rows (P, k) at active rows (a, k).

    fixed: (a,) bool, equations, whose multipliers may take either sign.
    """
    if not len(active):
        return plain_rates(rows)
    gram = active @ active.T
    gram[np.diag_indices(len(gram))] *= 1.0 + _RIDGE
    r = np.linalg.solve(gram, active @ rows.T)  # (a, P)
    rest = rows - r.T @ active
    # At the upper bound the multipliers become l - t r: they keep their sign while t r / l <= 1.
    share = np.where(fixed[:, None], 0.0, r / multiplier[:, None])
    return RowRates(
        np.einsum("pk,pk->p", rows, rows),
        np.einsum("pk,pk->p", rest, rest),
        1.0 / np.maximum(share.max(axis=0), 1e-300),
        1.0 / np.maximum((-share).max(axis=0), 1e-300),
    )
