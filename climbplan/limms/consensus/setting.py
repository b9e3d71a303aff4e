"""What both blocks of the consensus know of a scene: intervals, ends of modules, free space.

Interval k lies between knots k and k + 1 and has one mode; what is latched in it is latched at both
of its knots, so that a module changes hands only where both ends are in place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.scene.corridor import centre_blocks
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.schema.module import ModuleSpec

STABLE, FREE, HELD, STANDS, LEAPS = range(5)  # modes of the box in an interval
POINTS = 5  # ends of a module's straight links: points 0, 2, 3, 5 and 7 of its chain
CHAIN_POINTS = (0, 2, 3, 5, 7)
LEVER = 0.6  # [m] from a turning joint to what it moves, for speeds of points


@dataclass(frozen=True)
class Form:
    """What the published consensus and the improved one differ in."""

    seconds: tuple[float, ...]  # [s] of an interval in each mode of the box
    reach: bool  # lengths of links, joint ranges and joint speeds in the mixed-integer block, too
    follow: bool  # integers are frozen, free blocks of links follow the other block's poses


# With one second each, as published, a free fall drops ten metres a step
FORMS = {
    "improved": Form((2.0, 0.12, 0.6, 0.3, 0.12), True, True),
    "published": Form((1.0, 1.0, 1.0, 1.0, 1.0), False, False),
}


@dataclass(frozen=True)
class Setting:
    """A scene and the horizon."""

    scene: Scene
    intervals: int
    free: Array  # (R, 2, 3) largest free blocks of points [m]
    centres: Array  # (C, 2, 3) largest free blocks of the box's centre [m]
    links: Array  # (4,) lengths of the straight links [m]
    wall_end: IntArray  # (L,) end that latches to the terrain: 1 last; 0 if latched at the start
    form: Form

    @property
    def knots(self) -> int:
        """One more than intervals."""
        return self.intervals + 1

    @property
    def box_end(self) -> IntArray:
        """(L,) end with which an arm holds the box."""
        return 1 - self.wall_end


def setting_of(scene: Scene, intervals: int, form: Form = FORMS["improved"]) -> Setting:
    """The setting of a scene."""
    point = replace(scene, box_size=np.zeros((1, 3)), box_start=scene.box_start[:1])
    return Setting(
        scene=scene,
        intervals=intervals,
        free=centre_blocks(point),
        centres=centre_blocks(scene),
        links=link_lengths(scene.module),
        wall_end=np.where(scene.held >= 0, 0, 1),
        form=form,
    )


def link_lengths(module: ModuleSpec) -> Array:
    """Lengths (4,) of the straight links [m]."""
    a = module.link_lengths
    return np.array([a[0] + a[1], a[2], a[3] + a[4], a[5] + a[6]])


def chain_points(points: Array, module: ModuleSpec) -> Array:
    """All points (..., 8, 3) of modules from the ends of their straight links (..., 5, 3)."""
    a = module.link_lengths
    p = [points[..., i, :] for i in range(POINTS)]
    first = p[0] + a[0] / (a[0] + a[1]) * (p[1] - p[0])
    middle = p[2] + a[3] / (a[3] + a[4]) * (p[3] - p[2])
    last = p[3] + a[5] / (a[5] + a[6]) * (p[4] - p[3])
    return np.stack([p[0], first, p[1], p[2], middle, p[3], last, p[4]], axis=-2)


def start_points(setting: Setting) -> Array:
    """Points (L, 5, 3) of modules at the start: straight, upright or along anchors' normals."""
    scene = setting.scene
    along = np.concatenate([[0.0], np.cumsum(setting.links)])
    points = np.zeros((scene.count, POINTS, 3))
    for module in range(scene.count):
        base, axis = scene.stand[module], np.array([0.0, 0.0, 1.0])
        if scene.held[module] >= 0:
            wall = int(scene.held[module]) - scene.wall_offset
            base, axis = scene.wall_position[wall], scene.wall_normal[wall]
        points[module] = base + along[:, None] * axis
    return points
