"""Descent of a module from a wall: the motion from the ground to its anchor, reversed.

Motions of single modules are reversible, since everything else rests. A standing place is found by
latching to the anchor from there, and that motion is played backwards.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np

from climbplan.limms.modules.limbs import compute_standing_rotation
from climbplan.limms.motion.assembly import (
    compute_end_pose,
    latch_from_ground,
    list_standing_points,
)
from climbplan.limms.motion.moving import Blocked, compute_gaps
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.timeline import ARM, DRIVES, NOWHERE, PartialPlan, Stretch
from climbplan.limms.scene.bounds import find_module_stands

_MAX_PLACES = 3  # standing places to try


def climb_down(partial_plan: PartialPlan, module: int, rng: np.random.Generator) -> PartialPlan:
    """Return the plan after a module on the terrain by its last end has come down and drives.

    Raises:
        Blocked: The module hangs by its first end, or no path down was found.
    """
    scene, anchor = partial_plan.scene, int(partial_plan.tip_anchor[module])
    name = f"{scene.module_names[module]}: down"
    if anchor < scene.wall_offset:
        raise Blocked(f"{name}: it does not hang by its last end")
    target = compute_end_pose(partial_plan, module, 1)
    stands = find_module_stands(scene)
    heights = sorted({float(stand[2]) for stand in stands if not np.isnan(stand).any()})
    reason = Blocked(f"{name}: there is no place to stand")
    for height in heights:
        for point in islice(
            list_standing_points(scene, height, target, target.position), _MAX_PLACES
        ):
            standing = partial_plan.copy()
            standing.stretches = []
            standing.base_position[module], standing.base_rotation[module] = (
                point,
                compute_standing_rotation(0),
            )
            standing.angles[module] = 0.0
            standing.mode[module], standing.grounded[module] = DRIVES, 0
            standing.tip_anchor[module] = NOWHERE
            if compute_gaps(standing, module, standing.points(module)).min() < -1e-6:
                continue
            try:
                ascent = latch_from_ground(
                    standing, module, target, anchor, mode=ARM, name=name, rng=rng, tries=1
                )
                lowered = partial_plan.copy()
                move_joints(
                    lowered, module, target, 1, goal=ascent.angles[module], name=name, rng=rng
                )
            except Blocked as error:
                reason = error
                continue
            for stretch in reversed(ascent.stretches):
                lowered.add(reverse_stretch(stretch))
            lowered.mode[module], lowered.grounded[module] = DRIVES, 0
            lowered.tip_anchor[module] = NOWHERE
            return lowered
    raise reason


def reverse_stretch(stretch: Stretch) -> Stretch:
    """Return the same motion from its end to its beginning."""
    return replace(
        stretch,
        time=stretch.time[-1] - stretch.time[::-1],
        box=stretch.box[::-1],
        velocity=-stretch.velocity[::-1],
        acceleration=stretch.acceleration[::-1],
        turning=stretch.turning[::-1] * np.array([1.0, -1.0, 1.0]),
        base_position=stretch.base_position[::-1],
        base_rotation=stretch.base_rotation[::-1],
        angles=stretch.angles[::-1],
        rates=-stretch.rates[::-1],
        force=stretch.force[::-1],
    )
