"""Capsules that contain the links of limbs, for distances to terrain, body and other limbs.

Most robots state one radius, and a link is the straight piece from its joint to the next, the last
one to the toe. A URDF says more: each piece of a link's collision geometry has a capsule of its
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
    """C capsules of each of N limbs in many poses (...); limbs with fewer repeat some."""

    starts: Array  # (..., N, C, 3) [m]
    ends: Array  # (..., N, C, 3) [m], nearer the toe
    radius: Array  # (N, C) [m]
    link: IntArray  # (N, C) number of the joint that moves it
    to_toe: Array  # (N, C) [m] from a last link's end to the toe; infinite of other links

    def to_world(self, com: Array, rotation: Array) -> Self:
        """Return the capsules of bodies at com (..., 3) with rotations (..., 3, 3), world frame.

        rotation: axes of the body as columns.
        """
        rotation_transposed = np.swapaxes(rotation, -1, -2)[..., None, :, :]
        origin = com[..., None, None, :]
        return type(self)(
            origin + self.starts @ rotation_transposed,
            origin + self.ends @ rotation_transposed,
            self.radius,
            self.link,
            self.to_toe,
        )


def limb_capsules(robot: Robot, angles: Array) -> Capsules:
    """Return the capsules of all limbs, body frame; NaN where angles are.

    Args:
        robot: The robot.
        angles: Joint angles (..., N, J) [rad].
    """
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
    offset = np.linalg.norm(mounted.ends[:, :, 1] - robot.mechanism.toe_zero[:, None], axis=-1)
    last = mounted.joint == robot.joint_count - 1
    to_toe = np.where(last, offset, np.inf)
    return Capsules(starts, ends, mounted.radius, mounted.joint, to_toe)


def straight_capsules(points: Array, radius: float) -> Capsules:
    """Return straight capsules between joints and toe.

    Args:
        points: Joints and toe (..., N, P, 3) [m].
        radius: Of all capsules [m].
    """
    limbs, links = points.shape[-3], points.shape[-2] - 1
    link = np.broadcast_to(np.arange(links, dtype=np.int64), (limbs, links))
    return Capsules(
        points[..., :-1, :],
        points[..., 1:, :],
        np.full((limbs, links), radius),
        link,
        np.where(link == links - 1, 0.0, np.inf),
    )
