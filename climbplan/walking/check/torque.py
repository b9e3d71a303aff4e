"""Torques of standing legs, J' R' f by inverse kinematics, against motors' limits.

Of robots from URDFs alone: their plans carry joints, bounds and torque limits. Legs are massless,
as in the plan: what their own weight and inertia ask for, a simulation of the whole robot tells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.task.task import ANGLES, WalkTask, WalkTrajectory


@dataclass(frozen=True)
class LegLoads:
    """Of each interval and leg at the interval's beginning and end (N, 2, L); swinging legs: 0."""

    missing: Array  # (N, 2, L) [m] by which joints do not get a standing toe to where it is
    torque: Array  # (N, 2, L, 3) [N m]; infinite where they do not


def leg_loads(legs: WalkingLegs, task: WalkTask, found: WalkTrajectory) -> LegLoads:
    """What forces ask of the joints of standing legs."""
    stands = found.gait.contact[:-1]
    begin = toes_in_body(found.state[:-1], found.toes[:-1])
    end = toes_in_body(found.state[1:], found.toes[:-1])
    toes = np.stack([begin, end], axis=1)  # (N, 2, L, 3)
    both = np.broadcast_to(stands[:, None], toes.shape[:-1])
    rest = legs.chain.joint_points(legs.chain.posture)[:, -1]
    solution = legs.chain.inverse(np.where(both[..., None], toes, rest), legs.lower, legs.upper)
    R = rotation_world_body(found.state[:, ANGLES])
    turned = np.stack([R[:-1], R[1:]], axis=1)  # (N, 2, 3, 3)
    force = found.force[:-1, None] @ turned  # (N, 2, L, 3) body frame
    angles = solution.angles[..., 0, :, :]
    torque = (force[..., None, :] @ legs.chain.jacobian(angles))[..., 0, :]
    valid: BoolArray = solution.valid
    missing = np.where(both & ~valid, solution.missing[..., 0, :], 0.0)
    torque = np.where(valid[..., None], torque, np.inf)
    return LegLoads(missing, np.where(both[..., None], torque, 0.0))


def torque_residuals(task: WalkTask, found: WalkTrajectory) -> Iterator[tuple[str, Array, Array]]:
    """Names of checks, residuals and shares of limits (N, L); nothing of bodies without joints."""
    if task.legs is None:
        return
    loads = leg_loads(task.legs, task, found)
    missing = loads.missing.max(axis=1)
    yield "torque.reach", missing, np.zeros_like(missing)
    beyond = np.abs(loads.torque) - task.legs.max_torque
    share = np.abs(loads.torque) / task.legs.max_torque
    stands = found.gait.contact[:-1]
    worst = np.where(stands, beyond.max(axis=(1, 3)), 0.0)
    yield "torque.limit", worst, share.max(axis=(1, 3))
