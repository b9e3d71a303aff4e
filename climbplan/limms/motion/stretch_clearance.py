"""Whether anything touches anything in a stretch of a plan: all that moves against all there is."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import forward
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.timeline import Stretch
from climbplan.limms.scene.limms_scene import Pose, Scene
from climbplan.limms.scene.placement import rotate_to_world

TOUCH = -5e-5  # [m] gap below which a motion is refused
_STILL = 1e-12  # [m]
_LATCHED = 1e-6  # [m]


def require_clear_of_all(scene: Scene, stretch: Stretch) -> None:
    """Raise Blocked where modules touch solids, boxes, themselves or each other, with names.

    Also where one would have to turn its joints too fast, or lets go of the box on the way: the
    program looks at knots only.
    """
    _require_following(scene, stretch)
    radius = scene.module.radius
    segments = [_segments(scene, stretch, m) for m in range(scene.num_modules)]
    moving = [bool(np.ptp(each, axis=0).max() > _STILL) for each in segments]
    moves = max(np.ptp(stretch.box, axis=0).max(), np.ptp(stretch.turning[:, 0]))
    box_moves = bool(moves > _STILL)
    centres, yaws = _boxes(scene, stretch)
    for m, name in enumerate(scene.module_names):
        if moving[m]:
            solids = gap_to_blocks(segments[m], scene.solids[:, 0], scene.solids[:, 1], radius)
            _require(solids, f"module {name}", "something solid")
            _require(gap_within(segments[m], radius), f"module {name}", "itself")
        if moving[m] or box_moves:
            gap = gap_to_boxes(segments[m], centres, yaws, scene.box_size / 2, radius)
            _require(gap, f"module {name}", "a box")
        for other in range(m):
            if moving[m] or moving[other]:
                gap = gap_between(segments[m], segments[other], radius)
                _require(gap, f"module {name}", f"module {scene.module_names[other]}")


def _require_following(scene: Scene, stretch: Stretch) -> None:
    fastest = np.abs(stretch.rates).max(axis=(0, 2))
    for m, name in enumerate(scene.module_names):
        if fastest[m] > scene.module.max_joint_speed:
            raise Blocked(f"module {name} would have to turn at {fastest[m]:.1f} rad/s on the way")
        for end, anchors in enumerate((stretch.base_anchor, stretch.tip_anchor)):
            if 0 <= anchors[m] < 4:
                base = Pose(stretch.base_position[:, m], stretch.base_rotation[:, m])
                held = forward(scene.module, base, stretch.angles[:, m]).position[:, 7 * end]
                offset = scene.side_offset(0, int(anchors[m]))
                off = held - stretch.box - rotate_to_world(stretch.turning[:, 0], offset)
                if np.abs(off).max() > _LATCHED:
                    raise Blocked(f"module {name} does not reach the box all the way")


def _require(gap: Array, who: str, what: str) -> None:
    worst = float(gap.min())
    if worst < TOUCH:
        raise Blocked(f"{who} reaches {-1e3 * worst:.1f} mm into {what} on the way")


def _segments(scene: Scene, stretch: Stretch, module: int) -> Array:
    base = Pose(stretch.base_position[:, module], stretch.base_rotation[:, module])
    points = forward(scene.module, base, stretch.angles[:, module])
    return link_segments(points, scene.module.radius)


def _boxes(scene: Scene, stretch: Stretch) -> tuple[Array, Array]:
    """Centres (n, B, 3) and yaws (n, B) of all boxes."""
    count = len(stretch.time)
    parked = np.tile(scene.box_start[1:], (count, 1, 1))
    centres = np.concatenate([stretch.box[:, None], parked], axis=1)
    still = np.tile(scene.start_yaws[1:], (count, 1))
    return centres, np.concatenate([stretch.turning[:, :1], still], axis=1)
