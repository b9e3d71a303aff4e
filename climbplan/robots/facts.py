"""Facts about a robot: masses, reach, and the joint torques that standing takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from climbplan.arrays import Array, BoolArray
from climbplan.robots.kinematics import (
    by_point,
    jacobian_body,
    point_jacobian,
    pushed_points,
    sole_turns,
    solve_inverse_kinematics,
    toe_body,
)
from climbplan.robots.model import Robot
from climbplan.robots.task_robot import heading_as

_NUM_SAMPLES = 4000  # postures of each limb
_BALANCE_TOLERANCE = 1e-3  # of the weight, error of balance [-, m]: regularisation leaves a little


@dataclass(frozen=True)
class RobotFacts:
    """Facts about a robot of N limbs with up to J joints; body frame."""

    robot: Robot
    stance_angles: Array  # (N, J) [rad], NaN where the stance is out of reach
    standing_height: float  # [m] of the body's origin above the toes of the stance, mean
    uneven: float  # [m] between the highest and the lowest toe of the stance
    reach: Array  # (N,) farthest toe from the shoulder, of sampled postures [m]
    samples: Array  # (N, S, 3) toes of these postures [m]
    standing_force: Array | None  # (N,) upward on each toe of the stance [N]; None: it tips over
    standing_torque: Array | None  # (N, J) that it takes [N m]

    @property
    def standing_safety(self) -> float | None:
        """The smallest ratio of a torque limit to what standing takes; None if it tips over."""
        if self.standing_torque is None:
            return None
        exists = self.robot.has_joint
        torque = np.abs(self.standing_torque)[exists]
        limit = self.robot.max_torque[exists]
        return float(np.min(limit / np.maximum(torque, 1e-12)))


def measure_robot(robot: Robot, seed: int = 0) -> RobotFacts:
    """Measure a robot.

    Args:
        robot: The robot.
        seed: Of the postures that are sampled within its joint bounds.
    """
    up = np.broadcast_to([0.0, 0.0, 1.0], robot.stance_body.shape)
    robot = heading_as(robot, np.zeros(3))
    solution = solve_inverse_kinematics(
        robot, robot.stance_body, sole_turns(robot, np.zeros(3), up)
    )
    angles = np.where(solution.valid[:, None], solution.best(), np.nan)
    fraction = np.random.default_rng(seed).uniform(size=(_NUM_SAMPLES, *robot.joint_lower.shape))
    samples = robot.joint_lower + fraction * (robot.joint_upper - robot.joint_lower)
    toes = np.swapaxes(toe_body(robot, samples), 0, 1)  # (N, S, 3)
    reach = np.linalg.norm(toes - robot.shoulder_body[:, None], axis=2).max(axis=1)
    force = _compute_standing_force(robot, solution.valid)
    torque = None
    if force is not None:
        upward = np.stack([np.zeros_like(force), np.zeros_like(force), force], axis=1)
        jacobian = jacobian_body(robot, np.nan_to_num(angles))
        if robot.sole is not None:
            jacobian = point_jacobian(robot, np.zeros(3), np.nan_to_num(angles), up)
        torque = np.einsum("nij,ni->nj", jacobian, upward)
        if robot.sole is not None:  # at corners of soles
            force = force.reshape(robot.limb_count, -1).sum(axis=1)
            torque = torque.reshape(robot.limb_count, -1, robot.joint_count).sum(axis=1)
    height = robot.stance_body[:, 2]
    return RobotFacts(
        robot,
        angles,
        float(-height.mean()),
        float(np.ptp(height)),
        reach,
        toes,
        force,
        torque,
    )


def _compute_standing_force(robot: Robot, valid: BoolArray) -> Array | None:
    """Return upward forces (N,) on toes in reach that hold the weight, as even as possible.

    Of flat feet, forces (4 N,) at the corners of their soles. None where the robot tips over.
    """
    points = robot.stance_body
    if robot.sole is not None:
        points = pushed_points(robot, points, np.broadcast_to([0.0, 0.0, 1.0], points.shape))
        valid = by_point(robot, valid, 0)
    x, y = points[:, :2].T
    balance = np.vstack([np.ones_like(x), x, y]) * valid
    evenness = 1e-4 * np.eye(len(x))  # regularisation: as even as possible
    force, _ = nnls(
        np.vstack([balance, evenness]), np.concatenate([[robot.weight, 0.0, 0.0], np.zeros(len(x))])
    )
    residual = balance @ force - np.array([robot.weight, 0.0, 0.0])
    return force if np.abs(residual).max() < _BALANCE_TOLERANCE * robot.weight else None
