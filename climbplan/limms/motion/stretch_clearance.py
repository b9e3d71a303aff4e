"""Collision test of a stretch of a plan: all that moves against everything."""

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
from climbplan.limms.scene.limms_scene import FramePoses, ModuleScene
from climbplan.limms.scene.placement import rotate_to_world

TOUCH = -5e-5  # [m], smallest gap of a valid motion
_MOTION_TOLERANCE = 1e-12  # [m]
_LATCH_TOLERANCE = 1e-6  # [m]


def require_clear_of_all(scene: ModuleScene, stretch: Stretch) -> None:
    """Raise an error where modules touch solids, boxes, themselves or each other.

    Joint speeds and the contact with the box are tested, too, since programs constrain knots only.

    Raises:
        Blocked: Something is violated; the message names it.
    """
    _require_reachable(scene, stretch)
    radius = scene.module.radius
    segments = [_compute_segments(scene, stretch, m) for m in range(scene.num_modules)]
    is_moving = [bool(np.ptp(each, axis=0).max() > _MOTION_TOLERANCE) for each in segments]
    box_travel = max(np.ptp(stretch.box, axis=0).max(), np.ptp(stretch.turning[:, 0]))
    box_moves = bool(box_travel > _MOTION_TOLERANCE)
    centres, yaws = _list_box_placements(scene, stretch)
    for m, name in enumerate(scene.module_names):
        if is_moving[m]:
            solids = gap_to_blocks(segments[m], scene.solids[:, 0], scene.solids[:, 1], radius)
            _require(solids, f"module {name}", "something solid")
            _require(gap_within(segments[m], radius), f"module {name}", "itself")
        if is_moving[m] or box_moves:
            gap = gap_to_boxes(segments[m], centres, yaws, scene.box_size / 2, radius)
            _require(gap, f"module {name}", "a box")
        for second in range(m):
            if is_moving[m] or is_moving[second]:
                gap = gap_between(segments[m], segments[second], radius)
                _require(gap, f"module {name}", f"module {scene.module_names[second]}")


def _require_reachable(scene: ModuleScene, stretch: Stretch) -> None:
    """Raise an error where joints are too fast, or a latch leaves the box."""
    max_rates = np.abs(stretch.rates).max(axis=(0, 2))
    for m, name in enumerate(scene.module_names):
        if max_rates[m] > scene.module.max_joint_speed:
            raise Blocked(
                f"module {name} would have to turn at {max_rates[m]:.1f} rad/s on the way"
            )
        for end, anchors in enumerate((stretch.base_anchor, stretch.tip_anchor)):
            if 0 <= anchors[m] < 4:
                base = FramePoses(stretch.base_position[:, m], stretch.base_rotation[:, m])
                tip = forward(scene.module, base, stretch.angles[:, m]).position[:, 7 * end]
                offset = scene.side_offset(0, int(anchors[m]))
                error = tip - stretch.box - rotate_to_world(stretch.turning[:, 0], offset)
                if np.abs(error).max() > _LATCH_TOLERANCE:
                    raise Blocked(f"module {name} does not reach the box all the way")


def _require(gap: Array, subject: str, obstacle: str) -> None:
    """Raise an error where a gap is too small."""
    smallest = float(gap.min())
    if smallest < TOUCH:
        raise Blocked(f"{subject} reaches {-1e3 * smallest:.1f} mm into {obstacle} on the way")


def _compute_segments(scene: ModuleScene, stretch: Stretch, module: int) -> Array:
    """Return the link segments of a module (n, 4, 2, 3) [m]."""
    base = FramePoses(stretch.base_position[:, module], stretch.base_rotation[:, module])
    points = forward(scene.module, base, stretch.angles[:, module])
    return link_segments(points, scene.module.radius)


def _list_box_placements(scene: ModuleScene, stretch: Stretch) -> tuple[Array, Array]:
    """Return centres (n, B, 3) and yaws (n, B) of all boxes."""
    count = len(stretch.time)
    fixed_centres = np.tile(scene.box_start[1:], (count, 1, 1))
    centres = np.concatenate([stretch.box[:, None], fixed_centres], axis=1)
    fixed_yaws = np.tile(scene.start_yaws[1:], (count, 1))
    return centres, np.concatenate([stretch.turning[:, :1], fixed_yaws], axis=1)
