"""Reachability of the box by an arm: feasible inverse kinematics without collision.

Placements are tested by the closed-form inverse kinematics of each branch, within joint ranges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.arms.branch_choices import (
    APPROACH_MARGIN,
    RANGE_MARGIN,
    compute_clearance,
    is_off_singular,
)
from climbplan.limms.modules.chain import BRANCHES, range_excess
from climbplan.limms.modules.contact import gap_to_boxes, link_segments
from climbplan.limms.modules.limbs import (
    build_arm,
    compute_anchor_pose,
    compute_limb_angles,
    compute_limb_points,
)
from climbplan.limms.scene.bounds import Connection, anchor_wrist, max_chain_span, side_wrist
from climbplan.limms.scene.limms_scene import ModuleScene


@dataclass(frozen=True)
class HoldingMap:
    """Where an arm can hold a box, and where its links are then."""

    is_feasible: BoolArray  # (branches, n), arm holds the box at place
    links: Array  # (m, 4, 2, 3) segments where it is feasible, in order [m]

    def exclude_collisions(self, scene: ModuleScene) -> BoolArray:
        """Return where the arm clears all boxes of a scene but the first, bool (branches, n)."""
        is_free = self.is_feasible.copy()
        if scene.num_boxes > 1 and len(self.links):
            boxes = scene.box_start[1:], scene.start_yaws[1:], scene.box_size[1:] / 2
            gap = gap_to_boxes(self.links, *boxes, scene.module.radius)
            is_free[is_free] = gap.min(axis=(1, 2)) >= -1e-6
        return is_free


# By connection and end on the anchor: holding maps that ignore boxes delivered later
HoldingCache = dict[tuple[Connection, bool], HoldingMap]


def find_holding_places(
    scene: ModuleScene,
    connection: Connection,
    places: Array,
    on_first_end: bool,
    cache: HoldingCache,
) -> BoolArray:
    """Return where an arm can hold the box, bool (branches, n).

    Args:
        scene: The scene; its first box is the one to hold.
        connection: The anchor and the side of the box that the arm connects.
        places: Placements of the box (n, D) [m, rad]; the second one is the goal.
        on_first_end: Whether the first end of the module is on the anchor, else its last end.
        cache: Maps of the same box and places; the result is added.
    """
    if (connection, on_first_end) in cache:
        return cache[connection, on_first_end].exclude_collisions(scene)
    box_end = 1 if on_first_end else 0
    limb = build_arm(
        0, connection.side, compute_anchor_pose(scene, connection.root, 1 - box_end), box_end
    )
    # Programs keep a larger margin to joint limits where latches close; none closes at the goal
    margin = np.full(len(places), RANGE_MARGIN + APPROACH_MARGIN)
    margin[1] = RANGE_MARGIN
    is_near = is_within_span(scene, connection, places)
    is_holdable = np.zeros((len(BRANCHES), len(places)), bool)
    links = [np.empty((0, 4, 2, 3))]
    box = places[is_near]
    feet = np.broadcast_to(limb.fixed_position, (len(box), 3))
    for number, branch in enumerate(BRANCHES if len(box) else ()):
        angles, reach_error = compute_limb_angles(scene, limb, box, feet, branch)
        angles = (angles + np.pi) % (2 * np.pi) - np.pi
        is_feasible = (reach_error <= 0) & (range_excess(scene.module, angles) <= -margin[is_near])
        is_feasible &= is_off_singular(scene.module, angles)
        if is_feasible.any():
            gap = compute_clearance(
                scene, [limb], box[is_feasible], feet[is_feasible, None], angles[is_feasible, None]
            )
            is_feasible[is_feasible] = gap >= -1e-6
            points = compute_limb_points(
                scene, limb, box[is_feasible], feet[is_feasible], angles[is_feasible]
            )
            links.append(link_segments(points, scene.module.radius))
        is_holdable[number, is_near] = is_feasible
    cache[connection, on_first_end] = HoldingMap(is_holdable, np.concatenate(links))
    return is_holdable


def is_within_span(scene: ModuleScene, connection: Connection, places: Array) -> BoolArray:
    """Return where a stretched-out chain spans from its anchor to its side, bool (n,)."""
    wrists = side_wrist(scene, connection.side, places)
    away = np.linalg.norm(wrists - anchor_wrist(scene, connection.root), axis=1)
    return np.asarray(away <= max_chain_span(scene, connection.links))
