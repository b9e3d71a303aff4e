"""Locate the instants of a plan in its trajectory."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants


def find_instant_samples(plan: ClimbPlan) -> IntArray:
    """Find the trajectory sample (K,) of each instant: mid-swing, or the end of a push."""
    instant_of_sample = sample_instants(plan)
    sample_index = np.full(plan.instants.count, -1, np.int64)
    for k in range(plan.instants.count):
        samples = np.flatnonzero(instant_of_sample == k)
        if not len(samples):
            continue
        if plan.instants.lifted[k].any():
            sample_index[k] = samples[len(samples) // 2]
            continue
        # A push ends when the body is at its target; then the next limb is unloaded.
        deviation = np.abs(plan.trajectory.com[samples] - plan.instants.com[k]).max(axis=1)
        deviation = deviation + np.abs(plan.trajectory.rpy[samples] - plan.instants.rpy[k]).max(
            axis=1
        )
        command = plan.trajectory.joint_command[samples] - plan.forces.joint_command[k]
        deviation = deviation + np.abs(command).max(axis=(1, 2))
        sample_index[k] = samples[int(np.argmin(deviation))]
    return sample_index
