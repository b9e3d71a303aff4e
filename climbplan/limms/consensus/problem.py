"""The data of the consensus problem: intervals, ends of modules, free space.

Interval k lies between knots k and k + 1 and has one mode. A latch of an interval is closed at both
of its knots, so a module changes contacts only where both ends are in place.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.scene.corridor import decompose_free_space
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.schema.module import ModuleSpec

STABLE, FREE, HELD, STANDS, LEAPS = range(5)  # modes of the box in an interval
POINTS = 5  # ends of a module's straight links: points 0, 2, 3, 5 and 7 of its chain
CHAIN_POINTS = (0, 2, 3, 5, 7)
MAX_LEVER_ARM = 0.6  # [m] from a joint to the points it moves, for speed limits


@dataclass(frozen=True)
class ConsensusFormulation:
    """The differences between the consensus of X. Lin (UCLA 2022) and the improved one."""

    interval_seconds: tuple[float, ...]  # [s] of an interval in each mode of the box
    has_kinematics: bool  # link lengths, joint ranges and speeds in the integer block
    freezes_integers: bool  # integers are fixed; free blocks follow the kinematic poses


# With one second each, as published, a free fall drops ten metres per interval
FORMS = {
    "improved": ConsensusFormulation((2.0, 0.12, 0.6, 0.3, 0.12), True, True),
    "published": ConsensusFormulation((1.0, 1.0, 1.0, 1.0, 1.0), False, False),
}


@dataclass(frozen=True)
class ConsensusProblem:
    """A scene and the horizon."""

    scene: ModuleScene
    intervals: int
    free_blocks: Array  # (R, 2, 3) largest free blocks of points [m]
    centre_blocks: Array  # (C, 2, 3) largest free blocks of the box's centre [m]
    link_lengths: Array  # (4,) lengths of the straight links [m]
    wall_end: IntArray  # (L,) end that latches to the terrain: 1 last; 0 if latched at the start
    formulation: ConsensusFormulation

    @property
    def knots(self) -> int:
        """The number of knots, one more than intervals."""
        return self.intervals + 1

    @property
    def box_end(self) -> IntArray:
        """The end (L,) with which an arm holds the box."""
        return 1 - self.wall_end


def build_problem(
    scene: ModuleScene, intervals: int, formulation: ConsensusFormulation = FORMS["improved"]
) -> ConsensusProblem:
    """Build the consensus problem of a scene."""
    point_scene = replace(scene, box_size=np.zeros((1, 3)), box_start=scene.box_start[:1])
    return ConsensusProblem(
        scene=scene,
        intervals=intervals,
        free_blocks=decompose_free_space(point_scene),
        centre_blocks=decompose_free_space(scene),
        link_lengths=compute_link_lengths(scene.module),
        wall_end=np.where(scene.start_anchor >= 0, 0, 1),
        formulation=formulation,
    )


def compute_link_lengths(module: ModuleSpec) -> Array:
    """Return the lengths (4,) of the straight links [m]."""
    a = module.link_lengths
    return np.array([a[0] + a[1], a[2], a[3] + a[4], a[5] + a[6]])


def interpolate_chain_points(points: Array, module: ModuleSpec) -> Array:
    """Return all points (..., 8, 3) of modules from ends of their straight links (..., 5, 3)."""
    a = module.link_lengths
    p = [points[..., i, :] for i in range(POINTS)]
    first = p[0] + a[0] / (a[0] + a[1]) * (p[1] - p[0])
    middle = p[2] + a[3] / (a[3] + a[4]) * (p[3] - p[2])
    last = p[3] + a[5] / (a[5] + a[6]) * (p[4] - p[3])
    return np.stack([p[0], first, p[1], p[2], middle, p[3], last, p[4]], axis=-2)


def compute_start_points(problem: ConsensusProblem) -> Array:
    """Return points (L, 5, 3) of modules at the start, upright or along anchor normals."""
    scene = problem.scene
    distances = np.concatenate([[0.0], np.cumsum(problem.link_lengths)])
    points = np.zeros((scene.num_modules, POINTS, 3))
    for module in range(scene.num_modules):
        base, axis = scene.start_position[module], np.array([0.0, 0.0, 1.0])
        if scene.start_anchor[module] >= 0:
            anchor = int(scene.start_anchor[module]) - scene.wall_offset
            base, axis = scene.wall_position[anchor], scene.wall_normal[anchor]
        points[module] = base + distances[:, None] * axis
    return points
