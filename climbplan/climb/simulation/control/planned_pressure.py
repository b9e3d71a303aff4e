"""The planned forces of toes, at every sample of the motion."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.kinematics import contact_jacobian, held_rows


def compute_planned_pressure(plan: ClimbPlan) -> Array:
    """Compute the normal forces (T, N) of `compute_planned_forces` [N]."""
    normal = plan.instants.normal[np.maximum(sample_instants(plan), 0)]
    pressure: Array = np.einsum("tni,tni->tn", compute_planned_forces(plan), normal)
    return pressure


def compute_planned_forces(plan: ClimbPlan) -> Array:
    """Compute the forces (T, N, 3) that follow from commanded joint deflections [N].

    Forces solve tau = J^T f in the least-squares sense, which is exact away from singular postures.
    They are zero in the air.
    """
    trajectory, robot = plan.trajectory, plan.robot
    instant = sample_instants(plan)
    angles = compute_true_angles(plan, instant)
    torque = (angles - trajectory.joint_command) / joint_softness(robot)
    normal = plan.instants.normal[np.maximum(instant, 0)]
    jacobian = contact_jacobian(robot, trajectory.rpy, angles, normal)
    jacobian = held_rows(robot, trajectory.rpy, angles, normal, jacobian)  # (T, N, 3 or 6, J)
    inverse = np.linalg.pinv(np.swapaxes(jacobian, -1, -2), rcond=1e-6)
    force: Array = (inverse @ torque[..., None])[..., :3, 0] * trajectory.contact[..., None]
    return force
