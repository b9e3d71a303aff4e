"""Obstacles of a plan of modules for pictures: solids inside the space."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan


def find_obstacles(plan: LimmsPlan) -> Array:
    """Return blocks (n, 2, 3) that reach no end of the space, unlike walls and ground [m]."""
    outside = (plan.solids[:, 0] <= plan.solids[:, 0].min(axis=0)).any(axis=1)
    outside |= (plan.solids[:, 1] >= plan.solids[:, 1].max(axis=0)).any(axis=1)
    return np.asarray(plan.solids[~outside])
