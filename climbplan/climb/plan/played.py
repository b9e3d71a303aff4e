"""A plan's trajectory as it is played: instants of its samples, and joints of toes that stand."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.kinematics import standing_inverse

START = -1  # instant of samples before the first lift


def sample_instants(plan: ClimbPlan) -> IntArray:
    """Return the planned instant (T,) that each trajectory sample belongs to.

    A limb in the air belongs to the instant at which it is lifted, what follows to the push after
    it. START before the first lift.
    """
    contact, lifted = plan.trajectory.contact, plan.instants.lifted
    changes = np.flatnonzero((contact[1:] != contact[:-1]).any(axis=1)) + 1
    instant = np.full(len(contact), START, np.int64)
    k = START
    for first, last in zip([0, *changes], [*changes, len(contact)], strict=True):
        airborne = ~contact[first]
        if airborne.any():
            matching_instants = np.flatnonzero((lifted == airborne).all(axis=1))
            matching_instants = matching_instants[matching_instants > k]
            k = int(matching_instants[0]) if len(matching_instants) else k
        elif k >= 0 and lifted[k].any() and k + 1 < len(lifted):
            k += 1
        instant[first:last] = k
    return instant


def compute_true_angles(plan: ClimbPlan, instant: IntArray) -> Array:
    """Return joint angles (T, N, 3) with toes in contact where they stand, not where they are
    commanded.

    Commands press toes into the terrain; the toes stay on its surface. Limbs in the air follow
    their commands, as does a limb whose foothold the sample's body pose cannot reach.
    """
    trajectory, instants = plan.trajectory, plan.instants
    footholds = np.concatenate([plan.rounds.toes[:1], instants.toes])[instant + 1]  # (T, N, 3)
    standing = np.concatenate([np.ones((1, plan.robot.limb_count), bool), instants.contact])
    is_standing = trajectory.contact & standing[instant + 1]
    normal = np.concatenate([instants.normal[:1], instants.normal])[instant + 1]
    solution = standing_inverse(plan.robot, trajectory.com, trajectory.rpy, footholds, normal)
    return np.where(
        (is_standing & solution.valid)[..., None], solution.best(), trajectory.joint_command
    )
