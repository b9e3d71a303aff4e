"""Necessary conditions of plans: force, moment and reach of modules that hold the box as arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, GroundPatch, ModuleScene
from climbplan.limms.scene.phases import compute_load_sharing
from climbplan.limms.scene.placement import centre_of, rotate_to_world, yaw_of


@dataclass(frozen=True)
class Connection:
    """A chain of modules from an anchor of the terrain to a side of the box."""

    root: int  # number of the anchor among the terrain's
    side: int
    links: int = 1  # modules in the chain: an arm, and added arms on it


def check_holding(scene: ModuleScene, connections: Sequence[Connection]) -> str:
    """Return the latch limit that forbids holding the box at rest: "force", "moment", or ""."""
    offsets = np.array([scene.side_offset(0, c.side) for c in connections])
    load_sharing = compute_load_sharing(offsets, scene.module.max_force, scene.module.latch_moment)
    latch_wrenches = load_sharing @ np.array([0, 0, scene.weight, 0])
    num_latches = len(connections)
    if (
        np.linalg.norm(latch_wrenches[: 3 * num_latches].reshape(num_latches, 3), axis=1).max()
        > scene.module.max_force
    ):
        return "force"
    if (
        np.linalg.norm(latch_wrenches[3 * num_latches :].reshape(num_latches, 3), axis=1).max()
        > scene.module.latch_moment
    ):
        return "moment"
    return ""


def is_within_reach(
    scene: ModuleScene, connections: Sequence[Connection], placement: Array
) -> bool:
    """Return whether each stretched-out chain spans from its anchor to its side of the box.

    Args:
        scene: The scene.
        connections: Chains from anchors to sides.
        placement: Placement of the box (D,) [m, rad].
    """
    return all(
        joint_distance(anchor_wrist(scene, c.root), side_wrist(scene, c.side, placement))
        <= max_chain_span(scene, c.links)
        for c in connections
    )


def max_chain_span(scene: ModuleScene, links: int) -> float:
    """Return the largest distance from the first shoulder of a chain to its last wrist [m]."""
    a = scene.module.link_lengths
    return links * sum(a[2:5]) + (links - 1) * (a[0] + a[1] + a[5] + a[6])


def anchor_wrist(scene: ModuleScene, root: int) -> Array:
    """Return the wrist (3,) of a module on a terrain anchor: its nearest off-axis joint [m]."""
    a = scene.module.link_lengths
    wrist: Array = scene.wall_position[root] + (a[0] + a[1]) * scene.wall_normal[root]
    return wrist


def side_wrist(scene: ModuleScene, side: int, placement: Array) -> Array:
    """Return the wrist (3,) of a module latched to a side of the box at a placement (D,) [m]."""
    a = scene.module.link_lengths
    wrist_offset = scene.side_offset(0, side) + (a[5] + a[6]) * SIDE_NORMALS[side]
    return centre_of(placement) + rotate_to_world(yaw_of(placement), wrist_offset)


def joint_distance(first: Array, second: Array) -> float:
    """Return the distance between two joints [m]."""
    return float(np.linalg.norm(first - second))


def is_reachable_from_ground(scene: ModuleScene, wrist: Array) -> bool:
    """Return whether the last wrist of a driving module reaches a point (3,) from the ground."""
    return any(
        _is_reachable_from_patch(scene, patch, wrist)
        for patch in scene.patches
        if any(abs(float(stand[2]) - patch.height) < 1e-6 for stand in find_module_stands(scene))
    )


def _is_reachable_from_patch(scene: ModuleScene, patch: GroundPatch, wrist: Array) -> bool:
    a = scene.module.link_lengths
    horizontal_gap = np.maximum(np.maximum(patch.lower - wrist[:2], wrist[:2] - patch.upper), 0.0)
    height = float(wrist[2]) - patch.height - a[0] - a[1]
    return float(np.hypot(np.linalg.norm(horizontal_gap), height)) <= max_chain_span(scene, 1)


def find_module_stands(scene: ModuleScene) -> Array:
    """Return where modules stand or can stand (L, 3) [m], NaN for those on wall anchors.

    A module on an anchor of the ground may let go of it.
    """
    places = scene.start_position.copy()
    for module, anchor in enumerate(scene.start_anchor):
        root = int(anchor) - scene.wall_offset
        if anchor >= 0 and compute_ground_end_frame(scene, root):
            places[module] = scene.wall_position[root]
    return places


def compute_ground_end_frame(scene: ModuleScene, root: int) -> bool:
    """Return whether a terrain anchor is on the ground, so that its module stands upright."""
    return bool(scene.wall_normal[root][2] > 0.5)


def is_accessible(scene: ModuleScene, root: int) -> bool:
    """Return whether a module is on an anchor at the start or reaches it from the ground."""
    anchor = scene.wall_offset + root
    return bool((scene.start_anchor == anchor).any()) or is_reachable_from_ground(
        scene, anchor_wrist(scene, root)
    )


def is_accessible_over_box(scene: ModuleScene, connection: Connection, placement: Array) -> bool:
    """Return whether a module may reach a side of the box, and from there the anchor.

    Args:
        scene: The scene.
        connection: The side of the box and the anchor.
        placement: Placement of the box (D,) [m, rad].
    """
    wrist = side_wrist(scene, connection.side, placement)
    stretch = max_chain_span(scene, 1)
    is_side_reachable = is_reachable_from_ground(scene, wrist) or any(
        joint_distance(anchor_wrist(scene, int(a) - scene.wall_offset), wrist) <= stretch
        for a in scene.start_anchor
        if a >= 0
    )
    return (
        is_side_reachable and joint_distance(wrist, anchor_wrist(scene, connection.root)) <= stretch
    )
