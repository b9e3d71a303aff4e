"""Limb and whole-body stiffness by the virtual joint method (chapter 4).

Notation: f_i force on the robot at toe i, r_i from the body origin to toe i, P_i = skew(r_i),
B_i = [I P_i^T], delta_wall deflections imposed on the toes, delta_com translation and small
rotation of the body. Stiffness appears only where the text's equations need it. Everything else
uses the compliance, which stays finite in singular postures.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import ClimbplanError
from climbplan.robots.kinematics import rigid_motion
from climbplan.robots.model import Robot

_SINGULAR = 1e12  # condition number of a compliance beyond which a limb has no stiffness matrix
_REGULARISATION = 1e-12  # weight of the body's deflection, for contacts in a line


class SingularPosture(ClimbplanError):
    """A limb so stretched or folded that its stiffness is infinite in some direction."""


def limb_compliance(robot: Robot, jacobian: Array) -> Array:
    """Return the toe compliance J k^-1 J^T / (1 - share) of every limb, the inverse of eq. (4.7).

    The structure's share of the compliance (chapter 4.3) is added in proportion.

    Args:
        robot: The robot.
        jacobian: (..., N, 3, J), world frame [m/rad], or of several points of each limb.

    Returns:
        (..., N, 3, 3) [m/N], symmetric.
    """
    stiffness = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    scaled_jacobian = jacobian / _repeat_for_points(stiffness, jacobian)[:, None, :]
    return np.asarray(scaled_jacobian @ np.swapaxes(jacobian, -1, -2))


def limb_stiffness(robot: Robot, jacobian: Array) -> Array:
    """Return the toe stiffness K = (J k^-1 J^T)^-1 (1 - share) of every limb, eq. (4.7).

    Args:
        robot: The robot.
        jacobian: (..., N, 3, J), world frame [m/rad].

    Returns:
        (..., N, 3, 3) [N/m], symmetric positive definite.

    Raises:
        SingularPosture: The Jacobian has no inverse.
    """
    compliance = limb_compliance(robot, jacobian)
    if not (np.linalg.cond(compliance) < _SINGULAR).all():
        raise SingularPosture("a limb is in a singular posture: its stiffness is not defined")
    stiffness = np.linalg.inv(compliance)
    return np.asarray((stiffness + np.swapaxes(stiffness, -1, -2)) / 2)


def whole_body_stiffness(stiffness: Array, arms: Array) -> Array:
    """Return A = sum_i B_i^T K_i B_i, eq. (4.18).

    stiffness: (..., N, 3, 3) [N/m], zero for limbs in the air; arms: (..., N, 3) [m]. Returns
    (..., 6, 6).
    """
    motion = rigid_motion(arms)
    return np.asarray((np.swapaxes(motion, -1, -2) @ stiffness @ motion).sum(axis=-3))


def body_deflection(stiffness: Array, arms: Array, wall_deflection: Array, load: Array) -> Array:
    """Return the deflection of the body under a load with given wall deflections, eq. (4.17).

    stiffness: (..., N, 3, 3), zero for limbs in the air; arms, wall_deflection: (..., N, 3); load:
    (..., 6) on the body. Returns (..., 6) [m, rad].
    """
    motion = rigid_motion(arms)
    pushed = np.einsum("...nji,...njk,...nk->...i", motion, stiffness, wall_deflection)
    system = whole_body_stiffness(stiffness, arms)
    return np.linalg.solve(system, (load + pushed)[..., None])[..., 0]


def contact_forces(
    stiffness: Array, arms: Array, wall_deflection: Array, com_deflection: Array
) -> Array:
    """Return the forces f_i = K_i (delta_wall_i - B_i delta_com) on the robot, eq. (4.14).

    stiffness: (..., N, 3, 3); arms, wall_deflection: (..., N, 3); com_deflection: (..., 6). Returns
    (..., N, 3) [N].
    """
    toe_motion = np.einsum("...nij,...j->...ni", rigid_motion(arms), com_deflection)
    return np.einsum("...nij,...nj->...ni", stiffness, wall_deflection - toe_motion)


@dataclass(frozen=True)
class Deflections:
    """Wall and body deflections that produce given contact forces."""

    wall: Array  # (..., N, 3) [m], zero for limbs in the air
    com: Array  # (..., 6) deflection and small rotation of the body [m, rad]


def deflections_for_forces(
    compliance: Array, arms: Array, force: Array, contact: BoolArray, compensated: bool
) -> Deflections:
    """Return deflections with delta_wall_i = C_i f_i + B_i delta_com, the inverse of eq. (4.14).

    The six degrees of freedom that the forces leave open are delta_com. It is zero if
    `compensated`:
    commands then carry the body back to its planned pose. Otherwise the sum of squared wall
    deflections
    is smallest: the forces take no more deflection than they need, and the body sags.

    Args:
        compliance: (..., N, 3, 3) [m/N].
        arms: (..., N, 3) [m].
        force: (..., N, 3) [N].
        contact: (..., N) bool.
        compensated: Whether commands compensate the deflection of the body.
    """
    elastic = np.einsum("...nij,...nj->...ni", compliance, force) * contact[..., None]
    if compensated:
        return Deflections(elastic, np.zeros((*elastic.shape[:-2], 6)))
    motion = rigid_motion(arms) * contact[..., None, None]
    # With contacts in a line a rotation moves no toe: regularisation keeps it at zero. It does
    # not change the relation to the forces, which holds for any delta_com.
    length = np.sqrt((arms**2).sum(axis=-1).mean(axis=-1))
    weight = np.ones((*length.shape, 6)) * contact.sum(axis=-1)[..., None]
    weight[..., 3:] *= length[..., None] ** 2
    normal_matrix = np.einsum("...nki,...nkj->...ij", motion, motion)
    normal_matrix += _REGULARISATION * weight[..., None] * np.eye(6)
    right = -np.einsum("...nki,...nk->...i", motion, elastic)
    com = np.linalg.solve(normal_matrix, right[..., None])[..., 0]
    return Deflections(elastic + np.einsum("...nij,...j->...ni", motion, com), com)


def joint_turns(robot: Robot, jacobian: Array) -> Array:
    """Return joint motion by toe motion (..., N, J, 3): J^-1 for three joints.

    Redundant limbs take the least elastic energy, k^-1 J^T (J k^-1 J^T)^-1, a right inverse of J.
    jacobian: (..., N, 3, J).
    """
    if jacobian.shape[-1] == 3:
        return np.asarray(np.linalg.pinv(jacobian))
    root = np.sqrt(joint_softness(robot))[:, None, :]
    return np.asarray(np.swapaxes(root, -1, -2) * np.linalg.pinv(jacobian * root))


def joint_softness(robot: Robot) -> Array:
    """Return the compliance of joints (N, J), structure included [rad/(N m)].

    The structure's share of the compliance is counted to the joints, as in `limb_compliance`.
    """
    return np.asarray(1 / (robot.joint_stiffness * (1 - robot.structural_compliance_share)))


def _repeat_for_points(values: Array, jacobian: Array) -> Array:
    """Return values by limb (N, ...), repeated for every point of a Jacobian (..., C, 3, J)."""
    count = jacobian.shape[-3] // len(values)
    return values if count == 1 else np.repeat(values, count, axis=0)


def joint_bending(
    robot: Robot, jacobian: Array, arms: Array, contact: BoolArray, compensated: bool
) -> Array:
    """Return D with joint command = joint angles - D f: the deflection of joints by contact forces.

    A position-controlled joint under tau = J^T f settles tau / (k (1 - share)) from its command.
    With
    `compensated` D is just that, and commands keep the planned pose exactly. Otherwise the body's
    own
    deflection, linear in the forces by `deflections_for_forces`, moves the joints as well, to first
    order.

    Args:
        robot: The robot.
        jacobian: (..., C, 3, J), world frame [m/rad].
        arms: (..., C, 3) [m].
        contact: (..., C), of the limbs' toes or of several points of each, limb by limb.
        compensated: Whether commands compensate the deflection of the body.

    Returns:
        (..., N, J, C, 3) [rad/N], zero for limbs in the air.
    """
    n, limb_count = contact.shape[-1], robot.limb_count
    points = np.arange(n)
    limbs = points // (n // limb_count)
    is_in_contact = contact[..., None, None]
    softness = _repeat_for_points(joint_softness(robot), jacobian)
    by_limb = softness[..., None] * np.swapaxes(jacobian, -1, -2) * is_in_contact
    bending = np.zeros((*contact.shape[:-1], limb_count, jacobian.shape[-1], n, 3))
    bending[..., limbs, :, points, :] = np.moveaxis(by_limb, -3, 0)
    if compensated:
        return bending
    if n != limb_count:
        raise ValueError("a body that sags turns flat feet, which lie on their surfaces")
    compliance = limb_compliance(robot, jacobian)
    per_force = np.moveaxis(
        np.stack(
            [
                deflections_for_forces(compliance, arms, unit, contact, compensated).com
                for unit in _build_unit_forces(contact.shape)
            ]
        ),
        0,
        -1,
    )  # (..., 6, 3 N)
    joint_motion = (
        joint_turns(robot, jacobian) @ rigid_motion(arms) * is_in_contact
    )  # (..., N, J, 6)
    body_part = joint_motion @ per_force[..., None, :, :]
    return bending + body_part.reshape(bending.shape)


def commanded_depth(jacobian: Array, normal: Array, bending: Array) -> Array:
    """Return the penetration of commanded toes per contact force, (..., N, C, 3).

    Times the forces it is -n . J (command - joint angles) [m], to first order. Friction alone holds
    a
    toe where that is negative.

    Args:
        jacobian: (..., N, 3, J) [m/rad].
        normal: (..., N, 3), into free space.
        bending: (..., N, J, C, 3) of `joint_bending` [rad/N].
    """
    turns = np.einsum("...nij,...ni->...nj", jacobian, normal)
    return np.asarray(np.einsum("...nj,...njml->...nml", turns, bending, optimize=True))


def _build_unit_forces(shape: tuple[int, ...]) -> Array:
    """Return forces (3 N, ..., N, 3): one newton along one axis of one limb each."""
    n = shape[-1]
    units = np.eye(3 * n).reshape(3 * n, *[1] * (len(shape) - 1), n, 3)
    return np.broadcast_to(units, (3 * n, *shape, 3))
