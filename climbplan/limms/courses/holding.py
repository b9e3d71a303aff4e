"""Where an arm can hold the box: closed inverse kinematics within ranges, touching nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.arms.held_branches import (
    APPROACH_MARGIN,
    RANGE_MARGIN,
    clearance,
    off_singular,
)
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.contact import gap_to_boxes, link_segments
from climbplan.limms.modules.limbs import arm, limb_angles, limb_points, root_on_anchor
from climbplan.limms.scene.bounds import Connection, anchor_wrist, chain_stretch, side_wrist
from climbplan.limms.scene.limms_scene import Scene


@dataclass(frozen=True)
class Held:
    """Where an arm can hold a box, and where its links are then."""

    fits: BoolArray  # (branches, n)
    links: Array  # (m, 4, 2, 3) of those that fit, in order [m]

    def beside(self, scene: Scene) -> BoolArray:
        """Where it still can (branches, n), with all boxes of a scene but the first."""
        kept = self.fits.copy()
        if scene.boxes > 1 and len(self.links):
            others = scene.box_start[1:], scene.start_yaws[1:], scene.box_size[1:] / 2
            gap = gap_to_boxes(self.links, *others, scene.module.radius)
            kept[kept] = gap.min(axis=(1, 2)) >= -1e-6
        return kept


# By how an arm holds on: what was found beside the boxes that were there then
Known = dict[tuple[Connection, bool], Held]


def held_at(
    scene: Scene, connection: Connection, places: Array, by_first: bool, known: Known
) -> BoolArray:
    """Where an arm can hold the box (branches, n), its first or its last end on the anchor."""
    if (connection, by_first) in known:
        return known[connection, by_first].beside(scene)
    box_end = 1 if by_first else 0
    limb = arm(0, connection.side, root_on_anchor(scene, connection.root, 1 - box_end), box_end)
    # Where latches close programs keep further from the ends of ranges; at the goal none closes
    margin = np.full(len(places), RANGE_MARGIN + APPROACH_MARGIN)
    margin[1] = RANGE_MARGIN
    near = stretched_to(scene, connection, places)
    found = np.zeros((len(BRANCHES), len(places)), bool)
    links = [np.empty((0, 4, 2, 3))]
    box = places[near]
    feet = np.broadcast_to(limb.fixed_position, (len(box), 3))
    for number, branch in enumerate(BRANCHES if len(box) else ()):
        angles, missing = limb_angles(scene, limb, box, feet, branch)
        angles = (angles + np.pi) % (2 * np.pi) - np.pi
        fits = (missing <= 0) & (in_range(scene.module, angles) <= -margin[near])
        fits &= off_singular(scene.module, angles)
        if fits.any():
            gap = clearance(scene, [limb], box[fits], feet[fits, None], angles[fits, None])
            fits[fits] = gap >= -1e-6
            points = limb_points(scene, limb, box[fits], feet[fits], angles[fits])
            links.append(link_segments(points, scene.module.radius))
        found[number, near] = fits
    known[connection, by_first] = Held(found, np.concatenate(links))
    return found


def stretched_to(scene: Scene, connection: Connection, places: Array) -> BoolArray:
    """Where a chain, stretched out, spans from its anchor to its side of the box (n,)."""
    wrists = side_wrist(scene, connection.side, places)
    away = np.linalg.norm(wrists - anchor_wrist(scene, connection.root), axis=1)
    return np.asarray(away <= chain_stretch(scene, connection.links))
