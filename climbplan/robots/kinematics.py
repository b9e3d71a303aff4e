"""Forward and inverse kinematics of a robot's limbs, in the body frame and in the world.

The mechanism of a limb (`robots/mechanism.py`) is coxa, femur and tibia in closed form
(`coxa_femur_tibia.py`), or any chain of joints (`serial_chain.py`).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.errors import ReachFailure
from climbplan.robots.chain_pose import ChainPose
from climbplan.robots.mechanism import InverseKinematics
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.robots.serial_chain import SerialChain


def joint_points_body(robot: Robot, angles: Array) -> Array:
    """Return first joint, further joints and toe of every limb (shoulder, femur joint, knee, toe).

    angles: (..., N, J) [rad]. Returns (..., N, P, 3) in the body frame [m].
    """
    return robot.limbs.joint_points(angles)


def toe_body(robot: Robot, angles: Array) -> Array:
    """Return toe positions (..., N, 3) in the body frame [m] for angles (..., N, J) [rad]."""
    return joint_points_body(robot, angles)[..., -1, :]


def jacobian_body(robot: Robot, angles: Array) -> Array:
    """Return d(toe_body)/d(angles) of every limb, (..., N, 3, J), body frame [m/rad]."""
    return robot.limbs.jacobian(angles)


def toe_hessian(robot: Robot, angles: Array) -> Array:
    """Return second derivatives of toe_body by the angles of its limb, (..., N, 3, J, J) [m/rad^2].

    The first of the last three axes is the toe's, body frame.
    """
    return robot.limbs.hessian(angles)


def toe_world(robot: Robot, com: Array, rpy: Array, angles: Array) -> Array:
    """Return toe positions (..., N, 3) in the world [m].

    com, rpy: body poses (..., 3) [m, rad]; angles: (..., N, J) [rad].
    """
    rotation = rotation_world_body(rpy)
    return com[..., None, :] + np.einsum("...ij,...nj->...ni", rotation, toe_body(robot, angles))


def jacobian_world(robot: Robot, rpy: Array, angles: Array) -> Array:
    """Return d(toe_world)/d(angles) at a fixed body, (..., N, 3, J) [m/rad]."""
    rotation = rotation_world_body(rpy)
    return np.einsum("...ij,...njk->...nik", rotation, jacobian_body(robot, angles))


def contact_jacobian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Return d(contact point)/d(angles) at a fixed body, (..., N, 3, J), world frame [m/rad].

    The point is one of the last link: of point toes the toe, and where wrists hold grippers their
    centre.

    Args:
        robot: The robot.
        rpy: Rotation of the body (..., 3) [rad].
        angles: Joint angles (..., N, J) [rad].
        normal: Unit normals (..., N, 3) of the surfaces under the toes.
    """
    if robot.foot is None:
        return jacobian_world(robot, rpy, angles)
    jacobian = _build_contact_chains(robot, rpy, angles, normal).jacobian
    return np.einsum("...ij,...njk->...nik", rotation_world_body(rpy), jacobian)


def contact_hessian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Return second derivatives of the contact point, (..., N, 3, J, J), world frame [m/rad^2]."""
    hessian = toe_hessian(robot, angles)
    if robot.foot is not None:
        hessian = _build_contact_chains(robot, rpy, angles, normal).hessian
    return np.einsum("...il,...nljk->...nijk", rotation_world_body(rpy), hessian)


def contact_points(robot: Robot, toes: Array, normal: Array) -> Array:
    """Return the points (..., N, 3) where toes touch surfaces of unit normals (..., N, 3) [m]."""
    return toes if robot.foot is None else toes + robot.foot.arm(normal)


def point_jacobian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Return d(force point)/d(angles) at a fixed body, (..., C, 3, J), world frame [m/rad].

    C is N limbs times the points of a foot, limb by limb. It differs from `contact_jacobian` only
    for
    flat feet.
    """
    contact = contact_jacobian(robot, rpy, angles, normal)
    if robot.foot is None or robot.foot.points == 1:
        return contact
    world = rotation_world_body(rpy)[..., None, :, :]
    turning = world @ robot.limbs.turning(angles)  # (..., N, 3, J)
    arm = robot.foot.point_arms(normal)  # (..., N, P, 3)
    points = contact[..., None, :, :] - skew(arm) @ turning[..., None, :, :]
    return np.asarray(points.reshape(*contact.shape[:-3], -1, *contact.shape[-2:]))


def point_hessian(robot: Robot, rpy: Array, angles: Array, normal: Array) -> Array:
    """Return second derivatives of the force points, (..., C, 3, J, J), world frame [m/rad^2]."""
    if robot.foot is None or robot.foot.points == 1:
        return contact_hessian(robot, rpy, angles, normal)
    assert isinstance(robot.mechanism, SerialChain)
    pose = robot.mechanism.pose(angles)
    world = rotation_world_body(rpy)
    arms = robot.foot.point_arms(normal)
    hessians = []
    for point in range(robot.foot.points):
        local = np.einsum("...ji,...nj->...ni", world, arms[..., point, :])
        hessian = replace(pose, toe=pose.toe + local).hessian
        hessians.append(np.einsum("...il,...nljk->...nijk", world, hessian))
    both = np.stack(hessians, axis=-4)  # (..., N, P, 3, J, J)
    return np.asarray(both.reshape(*angles.shape[:-2], -1, *both.shape[-3:]))


def pushed_points(robot: Robot, toes: Array, normal: Array) -> Array:
    """Return the points (..., C, 3) at which forces act on feet on surfaces [m].

    normal: (..., N, 3) unit, of the surfaces.
    """
    if robot.foot is None or robot.foot.points == 1:
        return contact_points(robot, toes, normal)
    points = toes[..., None, :] + robot.foot.point_arms(normal)
    return np.asarray(points.reshape(*toes.shape[:-2], -1, 3))


def held_rows(robot: Robot, rpy: Array, angles: Array, normal: Array, jacobian: Array) -> Array:
    """Return the velocities (..., N, R, J) that a surface constrains, by joint speed, world frame.

    R = 3: the contact point, whose Jacobian (..., N, 3, J) is given. R = 6 for flat feet: the toe
    and
    the rotation of the foot.
    """
    if robot.sole is None:
        return jacobian
    world = rotation_world_body(rpy)[..., None, :, :]
    contact = contact_jacobian(robot, rpy, angles, normal)
    return np.concatenate([contact, world @ robot.limbs.turning(angles)], axis=-2)


def held_motion(robot: Robot, arms: Array) -> Array:
    """Return the constrained velocities (..., N, R, 6) by the twist of the body.

    arms: (..., C, 3) from the body's origin to the force points, limb by limb [m].
    """
    if robot.sole is None:
        return rigid_motion(arms)
    count = arms.shape[-2] // robot.limb_count
    middle = arms.reshape(*arms.shape[:-2], -1, count, 3).mean(axis=-2)
    turning = np.broadcast_to(np.eye(3, 6, 3), (*middle.shape[:-1], 3, 6))
    return np.concatenate([rigid_motion(middle), turning], axis=-2)


def rigid_motion(arms: Array) -> Array:
    """Return B = [I P^T]: displacement of points by a small body motion, eq. (4.12).

    arms: (..., 3) from the body origin to the points [m]. Returns (..., 3, 6).
    """
    identity = np.broadcast_to(np.eye(3), (*arms.shape, 3))
    return np.concatenate([identity, -skew(arms)], axis=-1)  # skew(r)^T = -skew(r)


def by_point(robot: Robot, values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Return values by limb along an axis, repeated for every point of their feet."""
    count = 1 if robot.foot is None else robot.foot.points
    return values if count == 1 else np.repeat(values, count, axis=axis)


def _build_contact_chains(robot: Robot, rpy: Array, angles: Array, normal: Array) -> ChainPose:
    """Return the chains in the body frame that end in the contact points of their feet."""
    assert robot.foot is not None
    assert isinstance(robot.mechanism, SerialChain)
    pose = robot.mechanism.pose(angles)
    local = np.einsum("...ji,...nj->...ni", rotation_world_body(rpy), robot.foot.arm(normal))
    return replace(pose, toe=pose.toe + local)


def to_body(com: Array, rpy: Array, points_world: Array) -> Array:
    """Return world points (..., N, 3) in the frame of bodies at com, rpy (..., 3)."""
    rotation = rotation_world_body(rpy)
    return np.einsum("...ji,...nj->...ni", rotation, points_world - com[..., None, :])


def sole_turns(robot: Robot, rpy: Array, normal: Array) -> Array | None:
    """Return rotations (..., N, 3, 3) of last links from zero angles, with soles on their surfaces.

    Args:
        robot: The robot.
        rpy: Rotation of the body (..., 3) [rad].
        normal: Normals (..., N, 3) of surfaces, unit or nearly so.

    Returns:
        The rotations; None where feet are not flat: their limbs turn freely.
    """
    return None if robot.sole is None else turns_under(robot, rotation_world_body(rpy), normal)


def turns_under(robot: Robot, rotation: Array, normal: Array) -> Array | None:
    """Return the rotations of `sole_turns` for bodies of rotations (..., 3, 3)."""
    sole = robot.sole
    if sole is None:
        return None
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    rotations = np.swapaxes(rotation, -1, -2)[..., None, :, :] @ sole.axes(unit)
    return np.asarray(rotations @ np.swapaxes(sole.axes_zero, -1, -2))


def solve_inverse_kinematics(
    robot: Robot, toes_body: Array, turns: Array | None = None, inside: Array | float = 0.0
) -> InverseKinematics:
    """Return joint angles that put the toes at toes_body.

    Args:
        robot: The robot.
        toes_body: Positions (..., N, 3), body frame [m].
        turns: Rotations (..., N, 3, 3) of last links from `sole_turns`; required for flat feet.
        inside: Margin (N, J) from joint bounds [rad].
    """
    bounds = robot.joint_lower + inside, robot.joint_upper - inside
    if turns is None:
        if robot.sole is not None:
            raise TypeError("flat feet lie on surfaces: expected the rotations of last links")
        return robot.limbs.inverse(toes_body, *bounds)
    assert isinstance(robot.mechanism, SerialChain)
    return robot.mechanism.inverse(toes_body, *bounds, turns)


def standing_inverse(
    robot: Robot, com: Array, rpy: Array, toes: Array, normal: Array
) -> InverseKinematics:
    """Return joint angles for toes on surfaces, world frame. Flat feet lie on the surfaces.

    Args:
        robot: The robot.
        com: Position of the body (..., 3) [m].
        rpy: Rotation of the body (..., 3) [rad].
        toes: Positions (..., N, 3) [m].
        normal: Unit normals (..., N, 3).
    """
    return solve_inverse_kinematics(robot, to_body(com, rpy, toes), sole_turns(robot, rpy, normal))


def require_reachable(
    robot: Robot, toes_body: Array, where: str, turns: Array | None = None
) -> Array:
    """Return joint angles (N, J) for one posture.

    Args:
        robot: The robot.
        toes_body: Positions (N, 3), body frame [m].
        where: The posture, for the message.
        turns: Rotations (N, 3, 3) of last links from `sole_turns`; required for flat feet.

    Raises:
        ReachFailure: A toe is out of reach; with the missing distance or the violated joint bound.
    """
    solution = solve_inverse_kinematics(robot, toes_body, turns)
    for limb in (int(i) for i in np.flatnonzero(~solution.valid)):
        bounds = robot.joint_lower, robot.joint_upper
        miss = robot.limbs.explain_miss(solution, toes_body, limb, *bounds)
        raise ReachFailure(
            robot.limb_names[limb], miss.reason, miss.missing, where, miss.joint, miss.past
        )
    return solution.best()
