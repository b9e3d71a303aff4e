"""A module on a wall comes back to the ground: the way that leads from there to its anchor, back.

Ways of single modules are as good backwards: everything else rests. So a place to stand is found by
latching to the anchor from there, and what was found is played from its end.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np

from climbplan.limms.modules.limbs import standing_rotation
from climbplan.limms.motion.assembly import latch_from_ground, root_pose, spots
from climbplan.limms.motion.moving import Blocked, gaps
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.timeline import ARM, DRIVES, NOWHERE, PartialPlan, Stretch
from climbplan.limms.scene.bounds import find_module_stands

_MOST = 3  # places that are tried


def climb_down(world: PartialPlan, module: int, rng: np.random.Generator) -> PartialPlan:
    """As the world is, but a module that hangs on the terrain by its last end stands and drives.

    Raises:
        Blocked: it hangs by its first end, or no way down was found.
    """
    scene, anchor = world.scene, int(world.tip_anchor[module])
    name = f"{scene.module_names[module]}: down"
    if anchor < scene.wall_offset:
        raise Blocked(f"{name}: it does not hang by its last end")
    target = root_pose(world, module, 1)
    stands = find_module_stands(scene)
    heights = sorted({float(stand[2]) for stand in stands if not np.isnan(stand).any()})
    reason = Blocked(f"{name}: there is no place to stand")
    for height in heights:
        for point in islice(spots(scene, height, target, target.position), _MOST):
            below = world.copy()
            below.stretches = []
            below.base_position[module], below.base_rotation[module] = point, standing_rotation(0)
            below.angles[module] = 0.0
            below.mode[module], below.grounded[module] = DRIVES, 0
            below.tip_anchor[module] = NOWHERE
            if gaps(below, module, below.points(module)).min() < -1e-6:
                continue
            try:
                up = latch_from_ground(below, module, target, anchor, ARM, name, rng, tries=1)
                lowered = world.copy()
                move_joints(lowered, module, target, 1, up.angles[module], name, rng)
            except Blocked as error:
                reason = error
                continue
            for stretch in reversed(up.stretches):
                lowered.add(backwards(stretch))
            lowered.mode[module], lowered.grounded[module] = DRIVES, 0
            lowered.tip_anchor[module] = NOWHERE
            return lowered
    raise reason


def backwards(stretch: Stretch) -> Stretch:
    """The same motion from its end to its beginning."""
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
