"""With what the plan presses each toe on its surface, at every sample of its motion."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.kinematics import contact_jacobian, held_rows


def planned_pressure(plan: ClimbPlan) -> Array:
    """(T, N) along the surface's normal, of what commands bend joints, zero in the air [N].

    Forces are the least squares of tau = J^T f: exact but near singular postures.
    """
    moving, robot = plan.trajectory, plan.robot
    instant = sample_instants(plan)
    angles = true_angles(plan, instant)
    torque = (angles - moving.joint_command) / joint_softness(robot)
    normal = plan.instants.normal[np.maximum(instant, 0)]
    jacobian = contact_jacobian(robot, moving.rpy, angles, normal)
    jacobian = held_rows(robot, moving.rpy, angles, normal, jacobian)  # (T, N, 3 or 6, J)
    inverse = np.linalg.pinv(np.swapaxes(jacobian, -1, -2), rcond=1e-6)
    force = (inverse @ torque[..., None])[..., :3, 0]
    pressure: Array = np.einsum("tni,tni->tn", force, normal) * moving.contact
    return pressure
