"""A slow regulator of the body's pose: it bends standing limbs until the body is where it should be.

Joints are commanded further by the turn that would carry the body back, J^-1 B dx, integrated, so
that a lasting load is taken up as well (the published climbs had such a loop on the attitude).
"""

from __future__ import annotations

import numpy as np

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.robots.kinematics import jacobian_world
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.simulation.conditions import Conditions

RATE = 0.5  # [1/s] at which an error is taken back
_MOST = np.array([0.06, 0.06, 0.06, 0.2, 0.2, 0.2])  # [m, rad] largest correction
_STRETCHED = 1e-2  # relative size below which directions of a Jacobian are left alone


class Regulator:
    """Corrections of the commands of one run."""

    def __init__(self, plan: ClimbPlan, conditions: Conditions) -> None:
        self.plan = plan
        self.planned = rotation_world_body(plan.trajectory.rpy)
        self.offset = np.zeros(6)

    def correction(self, sample: int, com: Array, rotation: Array, seconds: float) -> Array:
        """(N, 3) to be added to the joint commands [rad]."""
        moving = self.plan.trajectory
        apart = self.planned[sample] @ rotation.T
        turn = np.array(
            [apart[2, 1] - apart[1, 2], apart[0, 2] - apart[2, 0], apart[1, 0] - apart[0, 1]]
        )
        error = np.concatenate([moving.com[sample] - com, turn / 2])
        self.offset = np.clip(self.offset + RATE * seconds * error, -_MOST, _MOST)
        angles = moving.joint_command[sample]
        jacobian = jacobian_world(self.plan.robot, moving.rpy[sample], angles)
        arms = self.plan.robot.stance_body @ self.planned[sample].T
        motion = self.offset[:3] + np.cross(self.offset[3:], arms)
        bend = -(np.linalg.pinv(jacobian, rcond=_STRETCHED) @ motion[..., None])[..., 0]
        return np.asarray(bend * moving.contact[sample][:, None])
