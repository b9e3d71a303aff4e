"""Bounds that no plan escapes: force, moment and reach of modules that hold the box as arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, Patch, Scene
from climbplan.limms.scene.placement import centre_of, in_world, yaw_of
from climbplan.limms.scene.statement import held_forces


@dataclass(frozen=True)
class Connection:
    """A chain of modules from an anchor of the terrain to a side of the box."""

    root: int  # number of the anchor among those of the terrain
    side: int
    links: int = 1  # modules in the chain: an arm, and added arms on it


def holding_misfit(scene: Scene, connections: Sequence[Connection]) -> str:
    """Whether force or moment of the latches rules out holding the box at rest."""
    offsets = np.array([scene.side_offset(0, c.side) for c in connections])
    share = held_forces(offsets, scene.module.max_force, scene.module.latch_moment)
    both = share @ np.array([0, 0, scene.weight, 0])
    n = len(connections)
    if np.linalg.norm(both[: 3 * n].reshape(n, 3), axis=1).max() > scene.module.max_force:
        return "force"
    if np.linalg.norm(both[3 * n :].reshape(n, 3), axis=1).max() > scene.module.latch_moment:
        return "moment"
    return ""


def within_reach(scene: Scene, connections: Sequence[Connection], box: Array) -> bool:
    """Whether each chain, stretched out, spans from its anchor to its side of the box, at (D,)."""
    return all(
        span(anchor_wrist(scene, c.root), side_wrist(scene, c.side, box))
        <= chain_stretch(scene, c.links)
        for c in connections
    )


def chain_stretch(scene: Scene, links: int) -> float:
    """Largest distance from the first shoulder of a chain to its last wrist [m]."""
    a = scene.module.link_lengths
    return links * sum(a[2:5]) + (links - 1) * (a[0] + a[1] + a[5] + a[6])


def anchor_wrist(scene: Scene, root: int) -> Array:
    """Where the nearest joint off an anchor's axis is, a module latched to it (3,) [m]."""
    a = scene.module.link_lengths
    wrist: Array = scene.wall_position[root] + (a[0] + a[1]) * scene.wall_normal[root]
    return wrist


def side_wrist(scene: Scene, side: int, box: Array) -> Array:
    """The same for a side of the box to deliver, which is placed at `box` (D,) [m]."""
    a = scene.module.link_lengths
    out = scene.side_offset(0, side) + (a[5] + a[6]) * SIDE_NORMALS[side]
    return centre_of(box) + in_world(yaw_of(box), out)


def span(one: Array, other: Array) -> float:
    """Distance between two joints [m]."""
    return float(np.linalg.norm(one - other))


def from_ground(scene: Scene, wrist: Array) -> bool:
    """Whether a module that drives stands somewhere from which its last wrist comes there."""
    return any(
        _from_patch(scene, patch, wrist)
        for patch in scene.patches
        if any(abs(float(stand[2]) - patch.height) < 1e-6 for stand in standing_places(scene))
    )


def _from_patch(scene: Scene, patch: Patch, wrist: Array) -> bool:
    a = scene.module.link_lengths
    flat = np.maximum(np.maximum(patch.lower - wrist[:2], wrist[:2] - patch.upper), 0.0)
    up = float(wrist[2]) - patch.height - a[0] - a[1]
    return float(np.hypot(np.linalg.norm(flat), up)) <= chain_stretch(scene, 1)


def standing_places(scene: Scene) -> Array:
    """Where modules stand (L, 3) [m], or can: one on an anchor of the ground may let go.

    NaN for those on anchors of walls.
    """
    places = scene.stand.copy()
    for module, anchor in enumerate(scene.held):
        root = int(anchor) - scene.wall_offset
        if anchor >= 0 and on_ground(scene, root):
            places[module] = scene.wall_position[root]
    return places


def on_ground(scene: Scene, root: int) -> bool:
    """Whether an anchor of the terrain is on the ground, its module upright."""
    return bool(scene.wall_normal[root][2] > 0.5)


def access(scene: Scene, root: int) -> bool:
    """Whether a module is latched to an anchor at the start, or can come from the ground."""
    anchor = scene.wall_offset + root
    return bool((scene.held == anchor).any()) or from_ground(scene, anchor_wrist(scene, root))


def access_over_box(scene: Scene, connection: Connection, box: Array) -> bool:
    """Whether a module may come to a side of the box at (D,), and from there to the anchor."""
    wrist = side_wrist(scene, connection.side, box)
    stretch = chain_stretch(scene, 1)
    near = from_ground(scene, wrist) or any(
        span(anchor_wrist(scene, int(a) - scene.wall_offset), wrist) <= stretch
        for a in scene.held
        if a >= 0
    )
    return near and span(wrist, anchor_wrist(scene, connection.root)) <= stretch
