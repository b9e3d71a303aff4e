"""Joint torques of standing legs, J' R' f by inverse kinematics, and their limits.

Only robots from URDFs have them: their plans carry joints, bounds and torque limits. Legs are
massless, as in the plan; a simulation of the whole robot shows the torques of their own weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.check.reference_dynamics import transform_toes_to_body
from climbplan.walking.task.task import ANGLES, WalkTask, WalkTrajectory


@dataclass(frozen=True)
class LegLoads:
    """Joint loads of each leg at the beginning and end of each interval; 0 for swinging legs."""

    missing: Array  # (N, 2, L) [m] by which joints do not get a standing toe to where it is
    torque: Array  # (N, 2, L, 3) [N m]; infinite where they do not


def compute_leg_loads(legs: WalkingLegs, task: WalkTask, trajectory: WalkTrajectory) -> LegLoads:
    """Return the joint torques that contact forces require of standing legs."""
    contact = trajectory.gait.contact[:-1]
    begin = transform_toes_to_body(trajectory.state[:-1], trajectory.toes[:-1])
    end = transform_toes_to_body(trajectory.state[1:], trajectory.toes[:-1])
    toes = np.stack([begin, end], axis=1)  # (N, 2, L, 3)
    contact_at_ends = np.broadcast_to(contact[:, None], toes.shape[:-1])
    rest_toes = legs.chain.joint_points(legs.chain.posture)[:, -1]
    solution = legs.chain.inverse(
        np.where(contact_at_ends[..., None], toes, rest_toes), legs.lower, legs.upper
    )
    R = rotation_world_body(trajectory.state[:, ANGLES])
    rotations = np.stack([R[:-1], R[1:]], axis=1)  # (N, 2, 3, 3)
    force = trajectory.force[:-1, None] @ rotations  # (N, 2, L, 3) body frame
    angles = solution.angles[..., 0, :, :]
    torque = (force[..., None, :] @ legs.chain.jacobian(angles))[..., 0, :]
    valid: BoolArray = solution.valid
    missing = np.where(contact_at_ends & ~valid, solution.missing[..., 0, :], 0.0)
    torque = np.where(valid[..., None], torque, np.inf)
    return LegLoads(missing, np.where(contact_at_ends[..., None], torque, 0.0))


def generate_torque_residuals(
    task: WalkTask, trajectory: WalkTrajectory
) -> Iterator[tuple[str, Array, Array]]:
    """Yield names of checks, residuals and fractions of limits (N, L); none without joints."""
    if task.legs is None:
        return
    loads = compute_leg_loads(task.legs, task, trajectory)
    missing = loads.missing.max(axis=1)
    yield "stance.reach", missing, np.zeros_like(missing)
    violation = np.abs(loads.torque) - task.legs.max_torque
    fraction = np.abs(loads.torque) / task.legs.max_torque
    contact = trajectory.gait.contact[:-1]
    excess = np.where(contact, violation.max(axis=(1, 3)), 0.0)
    yield "torque.limit", excess, fraction.max(axis=(1, 3))
