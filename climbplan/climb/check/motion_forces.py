"""Contact forces under the joint commands of a motion, sample by sample.

Joints are springs about their commands. Where the forces of limbs that reach their footholds
balance the load, the body is on its path. A residual wrench deflects it, by eq. (4.17).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.feet import move_toes_to_contacts
from climbplan.climb.check.anew.kinematics import HeldLimbs, build_limbs
from climbplan.climb.check.anew.static_pose import (
    build_foot_jacobian,
    build_foot_motion,
    solve_contact_force,
    solve_joint_motion,
)
from climbplan.robots.model import Robot


@dataclass(frozen=True)
class MotionForces:
    """Deflections, forces and torques of T samples and N limbs."""

    deflection: Array  # (T, 6) of the body from its path, linear [m, rad]
    force: Array  # (T, N, 3) there, zero in the air [N]
    moment: Array  # (T, N, 3) on soles, about the toes, else zero [N m]
    torque: Array  # (T, N, J) [N m]


def compute_motion_forces(
    robot: Robot,
    com: Array,
    axes: Array,
    *,
    standing: HeldLimbs,
    command: Array,
    contact: BoolArray,
    load: Array,
    moment: Array | None = None,
    arm: Array | None = None,
    is_flat: bool = False,
) -> MotionForces:
    """Return the forces of bodies on their path, with limbs under given commands.

    Args:
        robot: The robot.
        com: (T, 3) body origins [m].
        axes: (T, 3, 3) body axes as rows.
        standing: Limbs that reach their footholds.
        command: (T, N, J) commanded joint angles [rad].
        contact: (T, N) bool, limb is in contact.
        load: (T, 6) force and moment on the body [N, N m].
        moment: (T, N, 3) moments of wrists about the toes [N m]; None without grippers.
        arm: (T, N, 3) from toes to the contact points of feet of finite size [m]; None for point
            feet.
        is_flat: Whether feet are flat, so that the terrain holds their orientation too.
    """
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    is_touching = contact[..., None]
    torque = np.where(is_touching, spring * (standing.angles - command), 0.0)
    limbs = build_limbs(robot, com, axes, standing.angles)
    toes = standing.points[..., -1, :]
    if arm is not None:
        limbs, toes = move_toes_to_contacts(limbs, arm), toes + arm
    jacobian = build_foot_jacobian(limbs, is_flat)
    wrist_torque = np.zeros_like(torque)  # part of the torques that moments take
    if moment is not None:
        wrist_torque = np.where(
            is_touching, (limbs.compute_angular_jacobian() @ moment[..., None])[..., 0], 0.0
        )
        load = load + np.concatenate([0 * load[:, :3], moment.sum(axis=1)], axis=1)
    motion = build_foot_motion(toes - com[:, None, :], is_flat)
    joint_motion = (
        solve_joint_motion(jacobian, motion, spring) * is_touching[..., None]
    )  # joints turn by -bend dx
    torque_flat = (torque - wrist_torque).reshape(len(com), -1)
    bend_flat = joint_motion.reshape(len(com), -1, 6)
    stiff_motion = joint_motion * spring[..., None]
    stiffness = np.swapaxes(bend_flat, 1, 2) @ stiff_motion.reshape(bend_flat.shape)
    # B^T J^-T tau: the wrench of the forces about the body origin.
    wrench = (np.swapaxes(bend_flat, 1, 2) @ torque_flat[..., None])[..., 0] + load
    deflection = np.full((len(com), 6), np.nan)
    is_finite = np.isfinite(stiffness).all(axis=(1, 2))
    inverse = np.linalg.pinv(stiffness[is_finite], rcond=1e-10, hermitian=True)
    deflection[is_finite] = (inverse @ wrench[is_finite][..., None])[..., 0]
    torque = torque - (stiff_motion @ deflection[:, None, :, None])[..., 0]
    foot_wrench = np.where(is_touching, solve_contact_force(jacobian, torque - wrist_torque), 0.0)
    sole_moment = foot_wrench[..., 3:] if is_flat else np.zeros_like(foot_wrench)
    return MotionForces(deflection, foot_wrench[..., :3], sole_moment, torque)
