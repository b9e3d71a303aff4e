"""Links as capsules, built anew from what the plan file says of them.

A piece of a chain's link is moved from its own joint inwards, joint by joint, each about or along
where it is at zero angles. Links of other robots are straight from joint to joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import joint_motions, slide_directions, turned_about
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

    @property
    def axis(self) -> Array:
        """(P, 2, 3)."""
        return np.stack([self.starts, self.ends], axis=1)


def capsules_at(
    robot: Robot, com: Array, axes: Array, angles: Array, points: Array
) -> Iterator[Capsule]:
    """All capsules of all limbs in the world, limb by limb.

    com: (P, 3), axes: (P, 3, 3) body axes as rows, angles: (P, N, J) [rad], points: (P, N, J+1, 3)
    joints and toes at these.
    """
    mounted, chain = robot.capsules, robot.mechanism
    last = robot.joint_count - 1
    moved, ways = angles, np.zeros((robot.limb_count, robot.joint_count, 3))
    if isinstance(chain, SerialChain):
        moved, ways = joint_motions(chain, angles), slide_directions(chain)
    for limb in range(robot.limb_count):
        if mounted is None or not isinstance(chain, SerialChain):
            for link in range(points.shape[-2] - 1):
                to_toe = 0.0 if link == last else np.inf
                one = points[:, limb, link], points[:, limb, link + 1]
                yield Capsule(limb, link, link, *one, robot.limb_radius, to_toe)
            continue
        for number, link in enumerate(int(j) for j in mounted.joint[limb]):
            ends = np.broadcast_to(mounted.ends[limb, number], (len(com), 2, 3))
            for joint in reversed(range(link + 1)):
                about, axis = chain.joint_zero[limb, joint], chain.axis_zero[limb, joint]
                angle = moved[:, limb, joint, None]
                ends = turned_about(ends, about, axis, angle) + angle[..., None] * ways[limb, joint]
            world = com[:, None] + ends @ axes
            off = np.linalg.norm(mounted.ends[limb, number, 1] - chain.toe_zero[limb])
            to_toe = float(off) if link == last else np.inf
            radius = float(mounted.radius[limb, number])
            yield Capsule(limb, link, number, world[:, 0], world[:, 1], radius, to_toe)
