"""How far first joints turn, as half spaces of toes that the convex statement can hold.

A coxa turns about the body's z axis. Where its bounds are less than 180 degrees apart a limb that
faces its toe has it in the wedge between two planes through the shoulder,

    n . (R' (p - com) - shoulder) >= 0,

which is linear in toe and body at a given rotation. With the turn t = rates (Theta - Theta0) in
the body frame to first order, R' (p - com) = v - t x v with v = R0' (p - com), and in the product
alone v is taken at the nominal stance:

    (R0 n) . (p - com) - (stance x n) . t >= n . shoulder.

Balls about nominal stances say the same where they lie within the wedge; only planes that cut a
ball are stated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.program import Program
from climbplan.robots.coxa_femur_tibia import CoxaFemurTibia
from climbplan.robots.kinematics import inverse, to_body
from climbplan.robots.model import Robot

_WIDEST = np.deg2rad(175.0)  # between bounds: beyond it they are no wedge
_LEFT = 0.1  # share of a wedge that margins leave at least
_AT_START = 1e-7  # [m] by which toes that are given may be past a plane, for rounding

Entries = Any  # an AffineArray, which NumPy's signatures do not know


def turns_first(robot: Robot) -> bool:
    """Whether the first joints of limbs are known to turn about the body's z axis."""
    return isinstance(robot.limbs, CoxaFemurTibia)


def turn_normals(robot: Robot, limb: int, inside: float = 0.0) -> Array:
    """Unit normals n (2, 3), body frame, of the planes that a toe is on the inner side of.

    inside: [rad] that the joint keeps within its bounds. (0, 3) for bounds that make no wedge, and
    for robots whose first joints are not known to turn about the body's z axis.
    """
    width = float(robot.joint_upper[limb, 0] - robot.joint_lower[limb, 0])
    if not turns_first(robot) or width > _WIDEST:
        return np.zeros((0, 3))
    kept = min(inside, (1.0 - _LEFT) * width / 2)
    low = robot.mount_yaw[limb] + robot.joint_lower[limb, 0] + kept
    high = robot.mount_yaw[limb] + robot.joint_upper[limb, 0] - kept
    return np.array([[-np.sin(low), np.cos(low), 0.0], [np.sin(high), -np.cos(high), 0.0]])


def start_room(robot: Robot, com: Array, rpy: Array, toes: Array) -> Array:
    """(N,) how far first joints are within their bounds in a posture [rad], 0 out of reach.

    Zero for robots whose first joints make no wedges.
    """
    if not turns_first(robot):
        return np.zeros(robot.limb_count)
    angle = inverse(robot, to_body(com, rpy, toes)).best()[:, 0]
    room = np.minimum(angle - robot.joint_lower[:, 0], robot.joint_upper[:, 0] - angle)
    return np.asarray(np.maximum(np.nan_to_num(room), 0.0))


def state_turns(
    p: Program,
    robot: Robot,
    radius: Array,
    inside: Array | None,
    start: tuple[Array, Array, Array],
    frame: tuple[Array, Array, Array],
    postures: tuple[Entries, Entries, Entries],
    moving: tuple[Entries, Entries],
) -> None:
    """Toes within the wedges of their coxae at the end of rounds, and as they leave and reach
    places; one block for each limb whose ball of `radius` (N,) [m] a plane cuts.

    inside: (N,) [rad] that joints keep within their bounds, none if None. start: body origin (3,),
    angles (3,) and toes (N, 3) of the start, on whose toes joints keep no more than there. frame:
    R0, rates and Theta0 of the linear rotation. postures: toes (M + 1, N, 3), body origins and
    angles (M + 1, 3). moving: the latter two (M, N, 3) as each limb moves.
    """
    toes, coms, turns = postures
    reference, rates, level = frame
    m = toes.shape[0] - 1
    out = robot.stance_body - robot.shoulder_body
    room = start_room(robot, *start)
    for limb, name in enumerate(robot.limb_names):
        kept = 0.0 if inside is None else float(inside[limb])
        normals = turn_normals(robot, limb, kept)
        cuts = normals @ out[limb] < radius[limb]
        if not cuts.any():
            continue
        every = np.tile(normals[cuts], (m, 1, 1))
        first = every.copy()
        # Where the start's toes stand no tightening changes
        first[0] = turn_normals(robot, limb, min(kept, float(room[limb])))[cuts]
        slack = np.zeros((m, 1))
        slack[0] = _AT_START
        at = [x[:, limb] for x in moving]
        inner, least = [], []
        for normal, toe, com, rpy, past in (
            (every, toes[1:, limb], coms[1:], turns[1:], 0.0),
            (every, toes[1:, limb], *at, 0.0),
            (first, toes[:-1, limb], *at, slack),
        ):
            arm = np.cross(robot.stance_body[limb], normal)  # (M, S, 3)
            along = (toe - com)[:, None].along((normal @ reference.T)[..., None])
            turning = (rpy - level)[:, None].along((arm @ rates)[..., None])
            inner.append((along - turning)[..., 0])
            least.append(normal @ robot.shoulder_body[limb] - past)
        p.between(
            f"workspace.turn_{name}",
            np.concatenate(inner, axis=1),
            np.concatenate(least, axis=1),
            np.inf,
            unit="m",
        )
