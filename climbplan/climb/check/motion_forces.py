"""What the joint commands of a motion press with, sample by sample.

Joints are springs about their commands. Where the forces of limbs that reach for their footholds
balance the load, the body is where the motion has it; what is left over moves it, by eq. (4.17).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.feet import touching_limbs
from climbplan.climb.check.anew.kinematics import StandingLimbs, limbs_at
from climbplan.climb.check.anew.static_pose import force_of, held_motion, held_rows, joints_by_body
from climbplan.robots.model import Robot


@dataclass(frozen=True)
class MotionForces:
    """T samples, N limbs."""

    deflection: Array  # (T, 6) of the body from its path, linear [m, rad]
    force: Array  # (T, N, 3) there, zero in the air [N]
    moment: Array  # (T, N, 3) on soles, about the toes, else zero [N m]
    torque: Array  # (T, N, J) [N m]


def motion_forces(
    robot: Robot,
    com: Array,
    axes: Array,
    standing: StandingLimbs,
    command: Array,
    contact: BoolArray,
    load: Array,
    moment: Array | None = None,
    arm: Array | None = None,
    flat: bool = False,
) -> MotionForces:
    """Forces for bodies at com (T, 3), axes (T, 3, 3) with limbs commanded to command (T, N, J).

    moment: (T, N, 3) that wrists bring, at the toes [N m]; arm: (T, N, 3) from toes to where feet
    of finite size touch [m]; flat: whether these are flat, and held as a whole.
    """
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    touching = contact[..., None]
    torque = np.where(touching, spring * (standing.angles - command), 0.0)
    limbs = limbs_at(robot, com, axes, standing.angles)
    toes = standing.points[..., -1, :]
    if arm is not None:
        limbs, toes = touching_limbs(limbs, arm), toes + arm
    jacobian = held_rows(limbs, flat)
    wrists = np.zeros_like(torque)  # part of the torques that moments take
    if moment is not None:
        wrists = np.where(touching, (limbs.turning() @ moment[..., None])[..., 0], 0.0)
        load = load + np.concatenate([0 * load[:, :3], moment.sum(axis=1)], axis=1)
    motion = held_motion(toes - com[:, None, :], flat)
    bend = joints_by_body(jacobian, motion, spring) * touching[..., None]  # joints turn by -bend dx
    torque_flat = (torque - wrists).reshape(len(com), -1)
    bend_flat = bend.reshape(len(com), -1, 6)
    firm = bend * spring[..., None]
    stiffness = np.swapaxes(bend_flat, 1, 2) @ firm.reshape(bend_flat.shape)
    # B^T J^-T tau: the wrench of the forces about the body origin.
    wrench = (np.swapaxes(bend_flat, 1, 2) @ torque_flat[..., None])[..., 0] + load
    deflection = np.full((len(com), 6), np.nan)
    fine = np.isfinite(stiffness).all(axis=(1, 2))
    inverse = np.linalg.pinv(stiffness[fine], rcond=1e-10, hermitian=True)
    deflection[fine] = (inverse @ wrench[fine][..., None])[..., 0]
    torque = torque - (firm @ deflection[:, None, :, None])[..., 0]
    push = np.where(touching, force_of(jacobian, torque - wrists), 0.0)
    own = push[..., 3:] if flat else np.zeros_like(push)
    return MotionForces(deflection, push[..., :3], own, torque)
