"""Links as capsules, computed from the data of the plan file.

A piece of a chain's link is moved from its own joint inwards, joint by joint, each about or along
its axis at zero angles. Links of other robots are straight from joint to joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import (
    compute_joint_motions,
    rotate_about_axis,
    select_slide_axes,
)
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class Capsule:
    """One capsule of a limb in P poses."""

    limb: int
    link: int  # number of the joint that moves it
    number: int  # among those of the limb
    starts: Array  # (P, 3) [m]
    ends: Array  # (P, 3) [m], nearer the toe
    radius: float  # [m]
    to_toe: float  # [m] from the end to the toe, infinite but on the last link

    @cached_property
    def axis(self) -> Array:
        """Return both ends of the axis (P, 2, 3) [m]."""
        return np.stack([self.starts, self.ends], axis=1)


def build_capsules(
    robot: Robot, com: Array, axes: Array, angles: Array, points: Array
) -> Iterator[Capsule]:
    """Yield all capsules of all limbs in the world, limb by limb.

    Args:
        robot: The robot.
        com: (P, 3) body origins [m].
        axes: (P, 3, 3) body axes as rows, world.
        angles: (P, N, J) joint angles [rad].
        points: (P, N, J+1, 3) joints and toes at these angles, world [m].
    """
    robot_capsules, chain = robot.capsules, robot.mechanism
    last_link = robot.joint_count - 1
    joint_motions_of_limbs, slide_axes = angles, np.zeros((robot.limb_count, robot.joint_count, 3))
    if isinstance(chain, SerialChain):
        joint_motions_of_limbs, slide_axes = (
            compute_joint_motions(chain, angles),
            select_slide_axes(chain),
        )
    for limb in range(robot.limb_count):
        if robot_capsules is None or not isinstance(chain, SerialChain):
            for link in range(points.shape[-2] - 1):
                to_toe = 0.0 if link == last_link else np.inf
                link_ends = points[:, limb, link], points[:, limb, link + 1]
                yield Capsule(limb, link, link, *link_ends, robot.limb_radius, to_toe)
            continue
        for index, link in enumerate(int(j) for j in robot_capsules.joint[limb]):
            ends = np.broadcast_to(robot_capsules.ends[limb, index], (len(com), 2, 3))
            for joint in reversed(range(link + 1)):
                joint_origin, axis = chain.joint_zero[limb, joint], chain.axis_zero[limb, joint]
                angle = joint_motions_of_limbs[:, limb, joint, None]
                ends = (
                    rotate_about_axis(ends, joint_origin, axis, angle)
                    + angle[..., None] * slide_axes[limb, joint]
                )
            world = com[:, None] + ends @ axes
            end_to_toe = np.linalg.norm(robot_capsules.ends[limb, index, 1] - chain.toe_zero[limb])
            to_toe = float(end_to_toe) if link == last_link else np.inf
            radius = float(robot_capsules.radius[limb, index])
            yield Capsule(limb, link, index, world[:, 0], world[:, 1], radius, to_toe)
