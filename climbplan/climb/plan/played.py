"""A plan's trajectory as it is played: instants of its samples, and joints of toes that stand."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.kinematics import standing_inverse

START = -1  # instant of samples before the first lift


def sample_instants(plan: ClimbPlan) -> IntArray:
    """The planned instant (T,) that each trajectory sample belongs to.

    A limb in the air belongs to the instant at which it is lifted, what follows to the push after
    it. START before the first lift.
    """
    contact, lifted = plan.trajectory.contact, plan.instants.lifted
    changes = np.flatnonzero((contact[1:] != contact[:-1]).any(axis=1)) + 1
    found = np.full(len(contact), START, np.int64)
    k = START
    for first, last in zip([0, *changes], [*changes, len(contact)], strict=True):
        airborne = ~contact[first]
        if airborne.any():
            later = np.flatnonzero((lifted == airborne).all(axis=1))
            later = later[later > k]
            k = int(later[0]) if len(later) else k
        elif k >= 0 and lifted[k].any() and k + 1 < len(lifted):
            k += 1
        found[first:last] = k
    return found


def true_angles(plan: ClimbPlan, instant: IntArray) -> Array:
    """Joint angles (T, N, 3) with toes in contact where they stand, not where they are commanded.

    Commands press toes into the terrain; the toes stay on its surface. Limbs in the air follow
    their commands, as does a limb whose foothold the sample's body pose cannot reach.
    """
    moving, instants = plan.trajectory, plan.instants
    stand = np.concatenate([plan.rounds.toes[:1], instants.toes])[instant + 1]  # (T, N, 3)
    standing = np.concatenate([np.ones((1, plan.robot.limb_count), bool), instants.contact])
    held = moving.contact & standing[instant + 1]
    normal = np.concatenate([instants.normal[:1], instants.normal])[instant + 1]
    solution = standing_inverse(plan.robot, moving.com, moving.rpy, stand, normal)
    return np.where((held & solution.valid)[..., None], solution.best(), moving.joint_command)
