"""Which toes tell where the body is, and where toes are by joint angles.

`control/joint_regulator.py` estimates the body's pose from them.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.planned_pressure import planned_pressure
from climbplan.climb.simulation.grips.gripping import gripped

_STANDS = 0.5  # part of its planned pressure at the next instant from which on a toe stands


def standing(plan: ClimbPlan) -> BoolArray:
    """(T, N) toes on their surfaces and pressed by half of what is planned when the body goes on.

    Of robots with grippers those that have had time to close.

    A toe that touches late slides a little while it takes load; so does one that is let go of.
    """
    if plan.grips is not None:
        return gripped(plan)  # which may as well be pulled
    instant = np.maximum(sample_instants(plan), 0)
    planned = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    following = np.minimum(instant + 1, len(planned) - 1)
    asked = np.minimum(
        np.where(plan.instants.contact[instant], planned[instant], np.inf),
        np.where(plan.instants.contact[following], planned[following], np.inf),
    )
    return plan.trajectory.contact & (planned_pressure(plan) >= _STANDS * asked)
