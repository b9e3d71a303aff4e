"""Obstacles of a plan of modules: solids that stand or hang in the room, for pictures."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan


def obstacles_of(plan: LimmsPlan) -> Array:
    """Blocks (n, 2, 3) that reach no end of the space [m]: walls and ground are thick, and do."""
    outside = (plan.solids[:, 0] <= plan.solids[:, 0].min(axis=0)).any(axis=1)
    outside |= (plan.solids[:, 1] >= plan.solids[:, 1].max(axis=0)).any(axis=1)
    return np.asarray(plan.solids[~outside])
