"""Joint commands that move toes by the errors of their footholds."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.worlds.nominal_world import number_footholds
from climbplan.robots.kinematics import held_rows, jacobian_world
from climbplan.simulation.world import World


def compute_foothold_commands(plan: ClimbPlan, world: World) -> Array:
    """Compute the change (T, N, J) of joint commands by the errors of footholds [rad].

    It is of first order. During a swing the error is interpolated between the two footholds.
    """
    trajectory = plan.trajectory
    if not world.placement.any():
        return np.zeros_like(trajectory.joint_command)
    footholds = number_footholds(trajectory.contact)
    limb = np.arange(plan.robot.limb_count)
    following = np.minimum(footholds.index + 1, world.placement.shape[1] - 1)
    phase = footholds.swing_phase[..., None]
    toe_error = (1 - phase) * world.placement[limb, footholds.index] + phase * world.placement[
        limb, following
    ]
    angles = compute_true_angles(plan, sample_instants(plan))
    jacobian = jacobian_world(plan.robot, trajectory.rpy, angles)
    normal = np.broadcast_to([0.0, 0.0, 1.0], toe_error.shape)  # has no effect on centers of soles
    constraint_rows = held_rows(
        plan.robot, trajectory.rpy, angles, normal, jacobian
    )  # flat feet keep their orientation
    inverse = np.linalg.pinv(constraint_rows, rcond=1e-3)[..., :3]
    return np.asarray((inverse @ toe_error[..., None])[..., 0])
