"""Commands that put toes off where they are meant to stand."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.climb.simulation.worlds.world import footholds_of
from climbplan.robots.kinematics import held_rows, jacobian_world
from climbplan.simulation.world import World


def missed_footholds(plan: ClimbPlan, world: World) -> Array:
    """(T, N, J) what to add to joint commands so that every foothold is missed by its error [rad].

    To first order; on the way from one foothold to the next the error goes over steadily.
    """
    moving = plan.trajectory
    if not world.placement.any():
        return np.zeros_like(moving.joint_command)
    holds = footholds_of(moving.contact)
    limb = np.arange(plan.robot.limb_count)
    after = np.minimum(holds.number + 1, world.placement.shape[1] - 1)
    share = holds.share[..., None]
    off = (1 - share) * world.placement[limb, holds.number] + share * world.placement[limb, after]
    angles = true_angles(plan, sample_instants(plan))
    jacobian = jacobian_world(plan.robot, moving.rpy, angles)
    normal = np.broadcast_to([0.0, 0.0, 1.0], off.shape)  # of no matter to middles of soles
    rows = held_rows(plan.robot, moving.rpy, angles, normal, jacobian)  # flat feet stay as they lie
    inverse = np.linalg.pinv(rows, rcond=1e-3)[..., :3]
    return np.asarray((inverse @ off[..., None])[..., 0])
