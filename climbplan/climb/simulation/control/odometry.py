"""Select the toes that leg odometry relies on.

`control/joint_regulator.py` estimates the body's pose from them.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.planned_pressure import compute_planned_pressure
from climbplan.climb.simulation.grips.gripping import find_closed_grippers

_PRESSURE_FRACTION = 0.5  # of the planned pressure at the next instant, for a toe to count
_LANDING_TIME = 0.2  # [s] from the planned touchdown until a toe that trails its command has landed


def find_trusted_toes(plan: ClimbPlan) -> BoolArray:
    """Find toes (T, N) in contact with at least half the pressure planned for the body's motion.

    Toes slide a little while they take load or lose it. A toe that swings fast trails its command
    and is still in the air when it should touch; its place is taken after `_LANDING_TIME`. Grippers
    count once they had time to close.
    """
    if plan.grips is not None:
        return find_closed_grippers(plan)  # grippers may be pulled
    instant = np.maximum(sample_instants(plan), 0)
    planned = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    following = np.minimum(instant + 1, len(planned) - 1)
    required = np.minimum(
        np.where(plan.instants.contact[instant], planned[instant], np.inf),
        np.where(plan.instants.contact[following], planned[following], np.inf),
    )
    is_pressed = compute_planned_pressure(plan) >= _PRESSURE_FRACTION * required
    return is_pressed & _find_landed_toes(plan)


def _find_landed_toes(plan: ClimbPlan) -> BoolArray:
    """Find toes (T, N) that have been in contact for `_LANDING_TIME`, or since the start."""
    time, contact = plan.trajectory.time, plan.trajectory.contact
    landed = contact.copy()
    for limb in range(contact.shape[1]):
        for first, last in spans_of(contact[:, limb]):
            if first:
                landed[first:last, limb] = time[first:last] >= time[first] + _LANDING_TIME
    return landed
