"""Where in a plan's trajectory its instants are."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants


def instant_samples(plan: ClimbPlan) -> IntArray:
    """(K,) the trajectory sample at which each instant is: mid-air, and the end of each push."""
    of = sample_instants(plan)
    found = np.full(plan.instants.count, -1, np.int64)
    for k in range(plan.instants.count):
        samples = np.flatnonzero(of == k)
        if not len(samples):
            continue
        if plan.instants.lifted[k].any():
            found[k] = samples[len(samples) // 2]
            continue
        # A push is over when the body is where it goes; then the next limb is unloaded.
        off = np.abs(plan.trajectory.com[samples] - plan.instants.com[k]).max(axis=1)
        off = off + np.abs(plan.trajectory.rpy[samples] - plan.instants.rpy[k]).max(axis=1)
        command = plan.trajectory.joint_command[samples] - plan.forces.joint_command[k]
        off = off + np.abs(command).max(axis=(1, 2))
        found[k] = samples[int(np.argmin(off))]
    return found
