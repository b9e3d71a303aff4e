"""What holds at one knot: the ends of every module, from the intervals before and after it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.copies import Modes
from climbplan.limms.consensus.module_rows import MARGIN
from climbplan.limms.consensus.setting import Setting
from climbplan.limms.modules.limbs import end_rotation, standing_rotation
from climbplan.limms.scene.limms_scene import SIDE_NORMALS

NOTHING, FIXED, ON_BOX, ON_PATCH, UPRIGHT, ON_MODULE = range(6)


@dataclass(frozen=True)
class End:
    """One end of a module: what holds it, where, and its frame."""

    kind: int = NOTHING
    place: Array | None = None  # (3,) of an anchor, or from the box's centre to its side [m]
    rotation: Array | None = None  # (3, 3); None: free
    patch: int = -1
    parent: int = -1
    side: int = -1  # of the box that a leg's foot stays ahead of


@dataclass(frozen=True)
class Hands:
    """Both ends of a module."""

    ends: tuple[End, End]

    @property
    def root(self) -> int:
        """An end with a constant frame; the end on its parent if an added arm has no other."""
        for end in (0, 1):
            if self.ends[end].rotation is not None and self.ends[end].kind in (ON_PATCH, UPRIGHT):
                return end
        fixed = [e for e in (0, 1) if self.ends[e].kind == FIXED]
        held = [e for e in (0, 1) if self.ends[e].kind == ON_BOX]
        return [*fixed, *held, 1][0]

    @property
    def parent(self) -> int:
        """The module that one of its ends is latched to, -1 if none."""
        return max(end.parent for end in self.ends)


def hands_at(setting: Setting, modes: Modes, knot: int) -> tuple[Hands, ...]:
    """Ends of all modules at a knot."""
    return tuple(_hands(setting, modes, m, knot) for m in range(setting.scene.count))


def _hands(setting: Setting, modes: Modes, m: int, knot: int) -> Hands:
    ends = [End(), End()]
    for k in _intervals(setting, knot):
        for number, end in _held(setting, modes, m, k):
            if ends[number].kind in (NOTHING, UPRIGHT):
                ends[number] = end
    return Hands((ends[0], ends[1]))


def _intervals(setting: Setting, knot: int) -> list[int]:
    return [k for k in (knot - 1, knot) if 0 <= k < setting.intervals]


def _held(setting: Setting, modes: Modes, m: int, k: int) -> Iterator[tuple[int, End]]:
    """Ends that an interval's modes hold."""
    scene = setting.scene
    patch = int(modes.ground[m, k])
    side = int(modes.mount[m, k])
    if patch >= 0:
        yield 0, End(ON_PATCH, None, standing_rotation(0), patch, side=side)
    elif modes.leg[m, k]:
        yield 0, End(UPRIGHT, None, standing_rotation(0), side=side)
    if side >= 0:
        frame = end_rotation(SIDE_NORMALS[side], 1)
        yield 1, End(ON_BOX, scene.side_offset(0, side), frame)
    wall = int(modes.wall[m, k])
    if wall >= 0:
        end = int(setting.wall_end[m])
        frame = end_rotation(scene.wall_normal[wall], end)
        yield end, End(FIXED, scene.wall_position[wall], frame)
    held = int(modes.hold[m, k])
    if held >= 0:
        end = int(setting.box_end[m])
        frame = end_rotation(SIDE_NORMALS[held], end)
        yield end, End(ON_BOX, scene.side_offset(0, held), frame)
    parent = int(modes.parent[m, k])
    if parent >= 0:
        yield 1, End(ON_MODULE, parent=parent)


def patch_bounds(setting: Setting, patch: int) -> tuple[Array, Array]:
    """Where the first end of a module that stands on a patch may be (3,), (3,) [m]."""
    ground = setting.scene.patches[patch]
    low = np.array([*(ground.lower + MARGIN), ground.height])
    high = np.array([*(ground.upper - MARGIN), ground.height])
    return low, high
