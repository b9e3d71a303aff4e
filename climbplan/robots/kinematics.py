"""Forward and inverse kinematics of a robot's limbs, in the body frame and in the world.

What a limb is made of is its mechanism's business (`robots/mechanism.py`): coxa, femur and tibia in
closed form (`coxa_femur_tibia.py`), or any chain of revolute joints (`serial_chain.py`).
"""

from __future__ import annotations

import numpy as np

from climbplan.errors import ReachFailure
from climbplan.robots.mechanism import InverseKinematics
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array, rotation_world_body


def joint_points_body(robot: Robot, angles: Array) -> Array:
    """First joint, further joints and toe of every limb (shoulder, femur joint, knee, toe).

    angles: (..., N, J) [rad]. Returns (..., N, P, 3) in the body frame [m].
    """
    return robot.limbs.joint_points(angles)


def toe_body(robot: Robot, angles: Array) -> Array:
    """Toe positions (..., N, 3) in the body frame [m] for angles (..., N, J) [rad]."""
    return joint_points_body(robot, angles)[..., -1, :]


def jacobian_body(robot: Robot, angles: Array) -> Array:
    """d(toe_body)/d(angles) of every limb, (..., N, 3, J), body frame [m/rad]."""
    return robot.limbs.jacobian(angles)


def toe_hessian(robot: Robot, angles: Array) -> Array:
    """Second derivatives of toe_body by the angles of its limb, (..., N, 3, J, J) [m/rad^2].

    The first of the last three axes is the toe's, body frame.
    """
    return robot.limbs.hessian(angles)


def toe_world(robot: Robot, com: Array, rpy: Array, angles: Array) -> Array:
    """Toe positions (..., N, 3) in the world for body poses (..., 3) and angles (..., N, J)."""
    rotation = rotation_world_body(rpy)
    return com[..., None, :] + np.einsum("...ij,...nj->...ni", rotation, toe_body(robot, angles))


def jacobian_world(robot: Robot, rpy: Array, angles: Array) -> Array:
    """d(toe_world)/d(angles) at a fixed body, (..., N, 3, J) [m/rad]."""
    rotation = rotation_world_body(rpy)
    return np.einsum("...ij,...njk->...nik", rotation, jacobian_body(robot, angles))


def contact_jacobian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """d(point that touches)/d(angles) at a fixed body, (..., N, 3, J), world frame [m/rad].

    normal: (..., N, 3) of the surfaces under the toes. The point is one of the last link: of point
    toes the toe, and where wrists hold grippers their centre.
    """
    jacobian = jacobian_world(robot, rpy, angles)
    if robot.foot is None:
        return jacobian
    turning = np.swapaxes(_turning_world(robot, rpy, angles), -1, -2)  # (..., N, J, 3)
    carried = np.cross(turning, robot.foot.arm(normal)[..., None, :])
    return np.asarray(jacobian + np.swapaxes(carried, -1, -2))


def contact_hessian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Its second derivatives by the angles of its limb, (..., N, 3, J, J), world [m/rad^2]."""
    rotation = rotation_world_body(rpy)
    hessian = np.einsum("...il,...nljk->...nijk", rotation, toe_hessian(robot, angles))
    if robot.foot is None:
        return hessian
    axes = np.swapaxes(_turning_world(robot, rpy, angles), -1, -2)  # (..., N, J, 3)
    carried = np.cross(axes, robot.foot.arm(normal)[..., None, :])
    for i in range(axes.shape[-2]):  # a_i x (a_j x arm) for i <= j, as joint i carries joint j
        own = np.swapaxes(np.cross(axes[..., i, None, :], carried[..., i:, :]), -1, -2)
        hessian[..., i, i:] += own
        hessian[..., i + 1 :, i] += own[..., 1:]
    return hessian


def contact_points(robot: Robot, toes: Array, normal: Array) -> Array:
    """Where toes (..., N, 3) with surfaces of unit normals (..., N, 3) under them touch [m]."""
    return toes if robot.foot is None else toes + robot.foot.arm(normal)


def _turning_world(robot: Robot, rpy: Array, angles: Array) -> Array:
    """Turning velocity of the last links by joint speeds (..., N, 3, J), world frame."""
    turning = robot.limbs.turning(angles)
    return np.einsum("...ij,...njk->...nik", rotation_world_body(rpy), turning)


def to_body(com: Array, rpy: Array, points_world: Array) -> Array:
    """World points (..., N, 3) in the frame of bodies at com, rpy (..., 3)."""
    rotation = rotation_world_body(rpy)
    return np.einsum("...ji,...nj->...ni", rotation, points_world - com[..., None, :])


def inverse(robot: Robot, toes_body: Array) -> InverseKinematics:
    """Joint angles that put the toes at toes_body (..., N, 3), body frame [m]."""
    return robot.limbs.inverse(toes_body, robot.joint_lower, robot.joint_upper)


def require_reachable(robot: Robot, toes_body: Array, where: str) -> Array:
    """Joint angles (N, J) for one posture.

    Raises ReachFailure with the limb, the missing reach or the violated joint bound.
    """
    solution = inverse(robot, toes_body)
    for limb in (int(i) for i in np.flatnonzero(~solution.valid)):
        bounds = robot.joint_lower, robot.joint_upper
        found = robot.limbs.miss(solution, toes_body, limb, *bounds)
        raise ReachFailure(
            robot.limb_names[limb], found.reason, found.missing, where, found.joint, found.past
        )
    return solution.best()
