"""Contacts at one knot: the ends of every module, from the intervals on both sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.block_solution import Modes
from climbplan.limms.consensus.module_rows import GROUND_MARGIN
from climbplan.limms.consensus.problem import ConsensusProblem
from climbplan.limms.modules.limbs import compute_end_rotation, compute_standing_rotation
from climbplan.limms.scene.limms_scene import SIDE_NORMALS

NOTHING, FIXED, ON_BOX, ON_PATCH, UPRIGHT, ON_MODULE = range(6)


@dataclass(frozen=True)
class EndContact:
    """One end of a module: what it is attached to, where, and its frame."""

    kind: int = NOTHING
    place: Array | None = None  # (3,) of an anchor, or from the box's centre to its side [m]
    rotation: Array | None = None  # (3, 3); None: free
    patch: int = -1
    parent: int = -1
    side: int = -1  # side of the box that a leg's foot stays in front of


@dataclass(frozen=True)
class ModuleContacts:
    """The contacts of both ends of a module."""

    ends: tuple[EndContact, EndContact]

    @property
    def root(self) -> int:
        """The end with a constant frame; the end on its parent if an added arm has no other."""
        for end in (0, 1):
            if self.ends[end].rotation is not None and self.ends[end].kind in (ON_PATCH, UPRIGHT):
                return end
        fixed = [e for e in (0, 1) if self.ends[e].kind == FIXED]
        on_box = [e for e in (0, 1) if self.ends[e].kind == ON_BOX]
        return [*fixed, *on_box, 1][0]

    @property
    def parent(self) -> int:
        """The module that one of its ends is latched to, -1 if none."""
        return max(end.parent for end in self.ends)


def find_contacts(problem: ConsensusProblem, modes: Modes, knot: int) -> tuple[ModuleContacts, ...]:
    """Return the contacts of all modules at a knot."""
    return tuple(
        _find_module_contacts(problem, modes, m, knot) for m in range(problem.scene.num_modules)
    )


def _find_module_contacts(
    problem: ConsensusProblem, modes: Modes, module: int, knot: int
) -> ModuleContacts:
    """Return the contacts of a module at a knot; those of the earlier interval come first."""
    ends = [EndContact(), EndContact()]
    for k in _adjacent_intervals(problem, knot):
        for index, end in _iterate_contacts(problem, modes, module, k):
            if ends[index].kind in (NOTHING, UPRIGHT):
                ends[index] = end
    return ModuleContacts((ends[0], ends[1]))


def _adjacent_intervals(problem: ConsensusProblem, knot: int) -> list[int]:
    """Return the intervals on both sides of a knot."""
    return [k for k in (knot - 1, knot) if 0 <= k < problem.intervals]


def _iterate_contacts(
    problem: ConsensusProblem, modes: Modes, module: int, k: int
) -> Iterator[tuple[int, EndContact]]:
    """Yield the ends of a module that the modes of an interval attach, with their contacts."""
    scene = problem.scene
    patch = int(modes.ground[module, k])
    side = int(modes.mount[module, k])
    if patch >= 0:
        yield 0, EndContact(ON_PATCH, None, compute_standing_rotation(0), patch, side=side)
    elif modes.leg[module, k]:
        yield 0, EndContact(UPRIGHT, None, compute_standing_rotation(0), side=side)
    if side >= 0:
        frame = compute_end_rotation(SIDE_NORMALS[side], 1)
        yield 1, EndContact(ON_BOX, scene.side_offset(0, side), frame)
    anchor = int(modes.wall[module, k])
    if anchor >= 0:
        end = int(problem.wall_end[module])
        frame = compute_end_rotation(scene.wall_normal[anchor], end)
        yield end, EndContact(FIXED, scene.wall_position[anchor], frame)
    held_side = int(modes.hold[module, k])
    if held_side >= 0:
        end = int(problem.box_end[module])
        frame = compute_end_rotation(SIDE_NORMALS[held_side], end)
        yield end, EndContact(ON_BOX, scene.side_offset(0, held_side), frame)
    parent = int(modes.parent[module, k])
    if parent >= 0:
        yield 1, EndContact(ON_MODULE, parent=parent)


def compute_patch_bounds(problem: ConsensusProblem, patch: int) -> tuple[Array, Array]:
    """Return bounds (3,), (3,) of the first end of a module that stands on a patch [m]."""
    ground = problem.scene.patches[patch]
    low = np.array([*(ground.lower + GROUND_MARGIN), ground.height])
    high = np.array([*(ground.upper - GROUND_MARGIN), ground.height])
    return low, high
