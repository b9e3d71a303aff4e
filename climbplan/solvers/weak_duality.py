"""Lower bounds by weak duality, for any multipliers."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance

_NEGLIGIBLE = 1e-7  # relative gradient along an unbounded direction that counts as zero


def compute_dual_bound(instance: Instance, x: Array, multipliers: Array) -> float:
    """Return a lower bound on an instance without balls from multipliers (m,) of its rows.

    With r = P x + q + A'y, the Lagrangian is at least -1/2 x'Px + r'x' - sup(y'row) for every x'.
    This holds for any x and y, so its minimum over the variables' bounds is valid.
    """
    y = np.where(np.isfinite(instance.row_upper), multipliers, np.minimum(multipliers, 0.0))
    y = np.where(np.isfinite(instance.row_lower), y, np.maximum(y, 0.0))
    right_side = np.where(y > 0, instance.row_upper, instance.row_lower)
    support = float(np.sum(y[y != 0] * right_side[y != 0]))
    curvature = instance.P @ x
    r = curvature + instance.q + instance.A.T @ y
    extreme = np.where(r > 0, instance.lower, instance.upper)
    open_ended = ~np.isfinite(extreme)
    if (np.abs(r[open_ended]) > _NEGLIGIBLE * (1.0 + np.abs(instance.q).max(initial=0.0))).any():
        return -np.inf
    box_minimum = float(
        np.sum(r[~open_ended] * extreme[~open_ended]) + r[open_ended] @ x[open_ended]
    )
    return instance.constant - 0.5 * float(x @ curvature) - support + box_minimum
