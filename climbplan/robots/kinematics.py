"""Forward and inverse kinematics of a robot's limbs, in the body frame and in the world.

What a limb is made of is its mechanism's business (`robots/mechanism.py`): coxa, femur and tibia in
closed form (`coxa_femur_tibia.py`), or any chain of revolute joints (`serial_chain.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.errors import ReachFailure
from climbplan.robots.chain_pose import ChainPose
from climbplan.robots.mechanism import InverseKinematics
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.robots.serial_chain import SerialChain


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
    if robot.foot is None:
        return jacobian_world(robot, rpy, angles)
    jacobian = _touching(robot, rpy, angles, normal).jacobian
    return np.einsum("...ij,...njk->...nik", rotation_world_body(rpy), jacobian)


def contact_hessian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Its second derivatives by the angles of its limb, (..., N, 3, J, J), world [m/rad^2]."""
    own = toe_hessian(robot, angles)
    if robot.foot is not None:
        own = _touching(robot, rpy, angles, normal).hessian
    return np.einsum("...il,...nljk->...nijk", rotation_world_body(rpy), own)


def contact_points(robot: Robot, toes: Array, normal: Array) -> Array:
    """Where toes (..., N, 3) with surfaces of unit normals (..., N, 3) under them touch [m]."""
    return toes if robot.foot is None else toes + robot.foot.arm(normal)


def _touching(robot: Robot, rpy: Array, angles: Array, normal: Array) -> ChainPose:
    """Chains in the body frame that end in the points of their feet that touch."""
    assert robot.foot is not None
    assert isinstance(robot.mechanism, SerialChain)
    pose = robot.mechanism.pose(angles)
    local = np.einsum("...ji,...nj->...ni", rotation_world_body(rpy), robot.foot.arm(normal))
    return replace(pose, toe=pose.toe + local)


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
