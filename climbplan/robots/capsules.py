"""Links as capsules: what is solid of a limb, for distances to terrain, body and other limbs.

Most robots tell one radius, and a link is the straight piece from its joint to the next, the last
one to the toe. A URDF tells more: each piece of a link's collision geometry has a capsule of its
own, which moves with the link (`urdf/capsule_fit.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class Capsules:
    """C capsules of each of N limbs in many poses (...); limbs with fewer have some twice."""

    starts: Array  # (..., N, C, 3) [m]
    ends: Array  # (..., N, C, 3) [m], nearer the toe
    radius: Array  # (N, C) [m]
    link: IntArray  # (N, C) number of the joint that moves it
    to_toe: Array  # (N, C) [m] from a last link's end to the toe; infinite of other links

    def moved(self, com: Array, rotation: Array) -> Self:
        """Those of bodies at com (..., 3), axes as columns of rotation (..., 3, 3), world."""
        turn = np.swapaxes(rotation, -1, -2)[..., None, :, :]
        at = com[..., None, None, :]
        return type(self)(
            at + self.starts @ turn, at + self.ends @ turn, self.radius, self.link, self.to_toe
        )


def limb_capsules(robot: Robot, angles: Array) -> Capsules:
    """Capsules of all limbs at angles (..., N, J) [rad], body frame; NaN where angles are."""
    mounted = robot.capsules
    if mounted is None or not isinstance(robot.mechanism, SerialChain):
        return straight_capsules(robot.limbs.joint_points(angles), robot.limb_radius)
    pose = robot.mechanism.pose(angles)
    limb = np.arange(robot.limb_count)[:, None]
    about = robot.mechanism.joint_zero[limb, mounted.joint]  # (N, C, 3)
    places = pose.places[..., limb, mounted.joint, :]
    turns = pose.turns[..., limb, mounted.joint, :, :]  # (..., N, C, 3, 3)
    starts, ends = (
        places + (turns @ (mounted.ends[:, :, end] - about)[..., None])[..., 0] for end in (0, 1)
    )
    off = np.linalg.norm(mounted.ends[:, :, 1] - robot.mechanism.toe_zero[:, None], axis=-1)
    last = mounted.joint == robot.joint_count - 1
    to_toe = np.where(last, off, np.inf)
    return Capsules(starts, ends, mounted.radius, mounted.joint, to_toe)


def straight_capsules(points: Array, radius: float) -> Capsules:
    """Straight pieces between joints and toe (..., N, P, 3), one radius for all [m]."""
    limbs, links = points.shape[-3], points.shape[-2] - 1
    link = np.broadcast_to(np.arange(links, dtype=np.int64), (limbs, links))
    return Capsules(
        points[..., :-1, :],
        points[..., 1:, :],
        np.full((limbs, links), radius),
        link,
        np.where(link == links - 1, 0.0, np.inf),
    )
