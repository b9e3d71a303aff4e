"""Stiffness of a robot that braces itself, about the pose in which its forces hold it.

Contact forces do not only balance. When the body moves, they rotate with the limbs that carry them,
and a robot that pushes hard enough buckles. With toes fixed at P_i, arms r_i = P_i - com, joints
that act as springs k (1 - share) about their commands, and a small body motion dx = (dp, dphi),

    J_i dtheta_i = -B_i dx,    df_i = J_i^-T (k - S_i) dtheta_i + dphi x f_i,

where S_i is the Hessian of f_i . toe_i by the joint angles. The wrench of all contacts changes by
-A dx, and A = A_0 + sum of terms linear in f. The remaining part of the elastic stiffness A_0 under
load is therefore a matter of linear matrix inequalities. Limbs of more than three joints turn them
with the least elastic energy. The load's effect on that distribution is of second order and left
out here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.mechanics.stiffness import joint_softness, joint_turns
from climbplan.robots.kinematics import by_point, held_motion, held_rows, point_hessian
from climbplan.robots.model import Robot
from climbplan.robots.rotations import skew

_MIN_STIFFNESS_RATIO = 1e-8  # over the largest stiffness, of directions that contacts resist


@dataclass(frozen=True)
class LoadedStiffness:
    """Stiffness of the body at B poses, in directions of unit elastic stiffness."""

    left: Array  # (B,) smallest ratio of loaded to elastic stiffness; < 0: buckles
    direction: Array  # (B, 6) body motion [m, rad] for which it is least, of unit elastic stiffness


@dataclass(frozen=True)
class BracedBody:
    """The quantities besides forces that determine the stiffness of B bodies on n contacts."""

    turn: Array  # (B, n, J, 6) joint turns of each point's limb by body motion, -J^-1 B
    hessian: Array  # (B, n, 3, J, J) of the points by joint angles, world frame [m]
    arms: Array  # (B, n, 3) [m]
    elastic: Array  # (B, 6, 6) A_0
    whitening: Array  # (B, 6, 6) W with W^T A_0 W = 1, zero columns for what is not resisted


def braced_body(
    robot: Robot,
    rpy: Array,
    angles: Array,
    jacobian: Array,
    arms: Array,
    *,
    contact: BoolArray,
    normal: Array,
) -> BracedBody:
    """Compute the elastic part of the stiffness.

    Args:
        robot: The robot.
        rpy: Rotations of the bodies (B, 3) [rad].
        angles: Joint angles (B, N, J) [rad].
        jacobian: Of the force points (B, C, 3, J), world frame, limb by limb.
        arms: To the force points (B, C, 3) [m].
        contact: (B, C) bool.
        normal: Of the surfaces (B, C, 3).
    """
    points_per_limb = contact.shape[-1] // robot.limb_count
    limb_normal = normal[:, ::points_per_limb]  # by limb
    rows = held_rows(robot, rpy, angles, limb_normal, jacobian)
    motion = held_motion(robot, arms)
    turn = -joint_turns(robot, rows) @ motion * contact[:, ::points_per_limb, None, None]
    hessian = point_hessian(robot, rpy, angles, limb_normal)
    torque = turn / joint_softness(robot)[..., None]
    count = len(arms)
    elastic = np.swapaxes(turn.reshape(count, -1, 6), 1, 2) @ torque.reshape(count, -1, 6)
    value, vector = np.linalg.eigh(elastic)
    is_resisted = value > _MIN_STIFFNESS_RATIO * value[:, -1:]
    scale = np.zeros_like(value)
    np.divide(1.0, np.sqrt(np.maximum(value, 0.0)), out=scale, where=is_resisted)
    whitening = vector * scale[:, None, :]
    return BracedBody(by_point(robot, turn, 1), hessian, arms, elastic, whitening)


def loaded_stiffness(body: BracedBody, force: Array) -> LoadedStiffness:
    """Return the stiffness that remains under balancing forces (B, N, 3) [N]."""
    value, vector = np.linalg.eigh(relative_stiffness(body, force))
    direction = (body.whitening @ vector[:, :, :1])[..., 0]
    return LoadedStiffness(1.0 + value[:, 0], direction)


def stiffness_lost(body: BracedBody, rows: IntArray, direction: Array) -> Array:
    """Return the stiffness ratio that forces take in given directions, (R, N, 3) per newton.

    Args:
        body: The bodies.
        rows: Bodies (R,).
        direction: Directions (R, 6) of unit elastic stiffness.
    """
    turn = np.einsum("rnij,rj->rni", body.turn[rows], direction)
    by_joints = np.einsum("rnijk,rnj,rnk->rni", body.hessian[rows], turn, turn)
    shift, rotation = direction[:, None, :3], direction[:, None, 3:]
    arms = body.arms[rows]
    # v^T A v of the part that turns with the body: 2 dp . (f x dphi) - (r.f)|dphi|^2
    # + (f.dphi)(r.dphi)
    square = (rotation**2).sum(axis=-1, keepdims=True)
    dot = (arms * rotation).sum(axis=-1, keepdims=True)
    by_body = 2 * np.cross(rotation, shift) - square * arms + dot * rotation
    return np.asarray(by_joints - by_body)


def stiffness_lost_matrices(body: BracedBody, rows: IntArray) -> Array:
    """Return M (R, N, 3, 6, 6) per newton, with 1 - sum M f the loaded stiffness over the elastic.

    The stiffness of bodies `rows` (R,) is at least a fraction t of the elastic one if and only if
    (1 - t) 1 - sum M f is positive semidefinite.
    """
    limbs = body.arms.shape[1]
    # All unit forces at once, each on a copy of the body
    units = np.tile(np.eye(3 * limbs).reshape(-1, limbs, 3), (len(rows), 1, 1))
    selected = BracedBody(*(np.repeat(v[rows], 3 * limbs, axis=0) for v in vars(body).values()))
    return -relative_stiffness(selected, units).reshape(len(rows), limbs, 3, 6, 6)


def relative_stiffness(body: BracedBody, force: Array) -> Array:
    """Return the change of the stiffness by forces (B, 6, 6), relative to the elastic one."""
    joint_stiffness = np.einsum("bnijk,bni->bnjk", body.hessian, force)
    turn = body.turn.reshape(len(force), -1, 6)
    lost = np.swapaxes(turn, 1, 2) @ (joint_stiffness @ body.turn).reshape(turn.shape)
    loaded = _compute_rotation_stiffness(body.arms, force) - lost
    return np.asarray(np.swapaxes(body.whitening, 1, 2) @ loaded @ body.whitening)


def _compute_rotation_stiffness(arms: Array, force: Array) -> Array:
    """Return the stiffness (B, 6, 6) of forces that keep their size and rotate with the body."""
    total = skew(force.sum(axis=1))
    outer = np.einsum("bni,bnj->bij", force, arms)
    out = np.zeros((len(force), 6, 6))
    out[:, :3, 3:] = total
    out[:, 3:, :3] = -total
    outward = np.einsum("bni,bni->b", force, arms)[:, None, None]
    out[:, 3:, 3:] = (outer + np.swapaxes(outer, 1, 2)) / 2 - outward * np.eye(3)
    return out
