"""Stiffness of a robot that braces itself, about the pose in which its forces hold it.

Contact forces do not only balance: when the body moves, they turn with the limbs that carry them,
and a robot that pushes hard enough buckles. With toes held at P_i, arms r_i = P_i - com, joints
that act as springs k (1 - share) about their commands, and a small body motion dx = (dp, dphi),

    J_i dtheta_i = -B_i dx,    df_i = J_i^-T (k - S_i) dtheta_i + dphi x f_i,

where S_i is the Hessian of f_i . toe_i by the joint angles. The wrench of all contacts changes by
-A dx, and A = A_0 + sum of terms linear in f: what is left of the elastic stiffness A_0 under load
is a matter of linear matrix inequalities. Limbs of more than three joints turn them with the least
elastic energy; that the load shifts their share of it is of second order and left out here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.mechanics.stiffness import joint_softness, joint_turns
from climbplan.robots.kinematics import by_point, held_motion, held_rows, point_hessian
from climbplan.robots.model import Robot
from climbplan.robots.rotations import skew

_RESISTED = 1e-8  # part of the largest stiffness: what is less is left to the load by the contacts


@dataclass(frozen=True)
class LoadedStiffness:
    """Stiffness of the body at B poses, in directions of unit elastic stiffness."""

    left: Array  # (B,) least share of the elastic stiffness that is left under load; < 0: buckles
    direction: Array  # (B, 6) body motion [m, rad] for which it is least, of unit elastic stiffness


@dataclass(frozen=True)
class BracedBody:
    """What the stiffness of B bodies on n points of contact depends on beside the forces."""

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
    contact: BoolArray,
    normal: Array,
) -> BracedBody:
    """The elastic part, for rpy (B, 3) and angles (B, N, J).

    arms (B, C, 3) to, and jacobian (B, C, 3, J) of, the points that are pushed, contact (B, C),
    normal (B, C, 3), world; limb by limb, of each as many as its foot has.
    """
    every = contact.shape[-1] // robot.limb_count
    own = normal[:, ::every]  # by limb
    rows = held_rows(robot, rpy, angles, own, jacobian)
    motion = held_motion(robot, arms)
    turn = -joint_turns(robot, rows) @ motion * contact[:, ::every, None, None]
    hessian = point_hessian(robot, rpy, angles, own)
    firm = turn / joint_softness(robot)[..., None]
    count = len(arms)
    elastic = np.swapaxes(turn.reshape(count, -1, 6), 1, 2) @ firm.reshape(count, -1, 6)
    value, vector = np.linalg.eigh(elastic)
    resisted = value > _RESISTED * value[:, -1:]
    scale = np.zeros_like(value)
    np.divide(1.0, np.sqrt(np.maximum(value, 0.0)), out=scale, where=resisted)
    whitening = vector * scale[:, None, :]
    return BracedBody(by_point(robot, turn, 1), hessian, arms, elastic, whitening)


def loaded_stiffness(body: BracedBody, force: Array) -> LoadedStiffness:
    """What forces (B, N, 3) [N] that balance the load leave of the stiffness."""
    value, vector = np.linalg.eigh(relative_stiffness(body, force))
    direction = (body.whitening @ vector[:, :, :1])[..., 0]
    return LoadedStiffness(1.0 + value[:, 0], direction)


def stiffness_lost(body: BracedBody, rows: IntArray, direction: Array) -> Array:
    """(R, N, 3) per newton: share of the elastic stiffness in given directions that forces take.

    direction: (R, 6) of unit elastic stiffness, for bodies `rows` (R,).
    """
    turn = np.einsum("rnij,rj->rni", body.turn[rows], direction)
    own = np.einsum("rnijk,rnj,rnk->rni", body.hessian[rows], turn, turn)
    shift, turned = direction[:, None, :3], direction[:, None, 3:]
    arms = body.arms[rows]
    # v^T A v of the part that turns with the body: 2 dp . (f x dphi) - (r.f)|dphi|^2
    # + (f.dphi)(r.dphi)
    square = (turned**2).sum(axis=-1, keepdims=True)
    along = (arms * turned).sum(axis=-1, keepdims=True)
    carried = 2 * np.cross(turned, shift) - square * arms + along * turned
    return np.asarray(own - carried)


def stiffness_lost_matrices(body: BracedBody, rows: IntArray) -> Array:
    """(R, N, 3, 6, 6) per newton: M with 1 - sum M f the stiffness left, relative to the elastic.

    Of bodies `rows` (R,). The stiffness left is at least a share t of the elastic one if and only
    if (1 - t) 1 - sum M f is positive semidefinite.
    """
    limbs = body.arms.shape[1]
    out = np.empty((len(rows), limbs, 3, 6, 6))
    part = BracedBody(*(value[rows] for value in vars(body).values()))
    for limb in range(limbs):
        for axis in range(3):
            unit = np.zeros_like(part.arms)
            unit[:, limb, axis] = 1.0
            out[:, limb, axis] = -relative_stiffness(part, unit)
    return out


def relative_stiffness(body: BracedBody, force: Array) -> Array:
    """(B, 6, 6) change of the stiffness by forces, relative to the elastic one."""
    bent = np.einsum("bnijk,bni->bnjk", body.hessian, force)
    turn = body.turn.reshape(len(force), -1, 6)
    lost = np.swapaxes(turn, 1, 2) @ (bent @ body.turn).reshape(turn.shape)
    loaded = _turned_with_body(body.arms, force) - lost
    return np.asarray(np.swapaxes(body.whitening, 1, 2) @ loaded @ body.whitening)


def _turned_with_body(arms: Array, force: Array) -> Array:
    """(B, 6, 6) stiffness from forces that keep their size and turn with the body."""
    total = skew(force.sum(axis=1))
    outer = np.einsum("bni,bnj->bij", force, arms)
    out = np.zeros((len(force), 6, 6))
    out[:, :3, 3:] = total
    out[:, 3:, :3] = -total
    outward = np.einsum("bni,bni->b", force, arms)[:, None, None]
    out[:, 3:, 3:] = (outer + np.swapaxes(outer, 1, 2)) / 2 - outward * np.eye(3)
    return out
