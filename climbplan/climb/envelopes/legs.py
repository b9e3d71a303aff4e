"""The limbs of a coupled problem: shoulders, stances, workspaces, and the characteristic scales.

Positions are measured in P (a length) and forces in F (the robot's weight), eqs. (5.8), (5.9), so
that components of both lie within [-1, 1]. P is one length for the limbs that envelopes were
published for, and longer where other robots reach farther.

Published methods, and equation numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot

POSITION_SCALE = 0.7  # [m] assumed: beyond the reach of any limb from the body's centre
GROUND_RADIUS = 0.2237  # [m] toe from shoulder in the published walking stance
GROUND_DROP = 0.181  # [m] body above its toes in that stance


@dataclass(frozen=True)
class Legs:
    """N limbs that stand, in the body frame."""

    names: tuple[str, ...]
    shoulder: Array  # (N, 3) [m]
    stance: Array  # (N, 3) nominal toes [m]
    reach: float  # largest shoulder-toe distance [m]
    stance_radius: float  # largest toe distance from its stance [m]
    length: float = POSITION_SCALE  # P [m]

    @property
    def count(self) -> int:
        """N."""
        return len(self.names)


def select_wall_legs(robot: Robot, names: tuple[str, ...]) -> Legs:
    """Return the named limbs of a robot in its own stance."""
    index = [robot.limb_names.index(name) for name in names]
    return Legs(
        names,
        robot.shoulder_body[index],
        robot.stance_body[index],
        robot.reach,
        robot.stance_radius,
    )


def select_standing_legs(robot: Robot, names: tuple[str, ...]) -> Legs:
    """Return the named limbs in the robot's stance, with a P beyond any limb's reach."""
    legs = select_wall_legs(robot, names)
    by_shoulder = np.linalg.norm(legs.shoulder, axis=1) + legs.reach
    by_stance = np.linalg.norm(legs.stance, axis=1) + legs.stance_radius
    farthest = float(np.minimum(by_shoulder, by_stance).max())
    return replace(legs, length=max(POSITION_SCALE, farthest))


def select_ground_legs(robot: Robot, names: tuple[str, ...]) -> Legs:
    """Return the named limbs in the walking stance: toes outwards of the shoulders and below."""
    index = [robot.limb_names.index(name) for name in names]
    yaw = robot.mount_yaw[index]
    outward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(len(index))], axis=1)
    stance = robot.shoulder_body[index] + GROUND_RADIUS * outward - [0.0, 0.0, GROUND_DROP]
    return Legs(names, robot.shoulder_body[index], stance, robot.reach, robot.stance_radius)


def build_ball_directions() -> Array:
    """Return 26 directions (26, 3): faces, edges and corners of a cube."""
    grid = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    return grid / np.linalg.norm(grid, axis=1, keepdims=True)


# Least cosine between any direction and the nearest of the 26: the polytope of half-spaces
# d . x <= r INSCRIBED lies inside the ball of radius r, and touches it at its corners. Attained at
# the corner of the three tangent planes of a face, an edge and a corner direction of the cube.
INSCRIBED = float(
    1.0 / np.sqrt(1.0 + (np.sqrt(2.0) - 1.0) ** 2 + (np.sqrt(3.0) - np.sqrt(2.0)) ** 2)
)
