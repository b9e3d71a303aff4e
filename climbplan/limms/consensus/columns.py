"""The variables of the mixed-integer block, by what they mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.setting import POINTS, Setting
from climbplan.limms.scene.limms_scene import Scene
from climbplan.program.linear_rows import LinearRows

FASTEST = 6.0  # [m/s] of the box


@dataclass(frozen=True)
class Columns:
    """Numbers of columns; K intervals, L modules, W anchors, P patches, R free blocks."""

    box: IntArray  # (5, K) z_B: mode of the box, as in `setting`
    legs: IntArray  # (1,) whether the box walks; else it is held or thrown
    drives: IntArray  # (L, K) z_L1
    arm: IntArray  # (L, K) z_L2
    added: IntArray  # (L, K) z_L3
    leg: IntArray  # (L, K) z_L4
    hold: IntArray  # (4, L, K) z_S2: a side of the box is held by an arm
    mount: IntArray  # (4, L, K) z_S3: a side of the box has a leg
    wall: IntArray  # (W, L, K) z_W2
    carry: IntArray  # (L, L, K) z_Ac: parent, child
    ground: IntArray  # (P, L, K) delta_Lg: the first end stands on a patch
    region: IntArray  # (R, 4, L, K + 1) delta_La of links; empty if there is one block
    centre: IntArray  # (C, K) delta_Ba of the box's centre; empty if there is one block
    position: IntArray  # (K + 1, 3) p_B
    velocity: IntArray  # (K + 1, 3)
    in_mode: IntArray  # (3, K, 3) velocity where free or leaping, held, standing
    pull: IntArray  # (2, K, 3) acceleration where held, standing
    force: IntArray  # (4, K, 3) of arms at the sides of the box
    moment: IntArray  # (4, K, 3) of latches
    push: IntArray  # (L, K, 3) of feet
    points: IntArray  # (K + 1, L, 5, 3) p_L
    moved: IntArray  # (L, K) largest way of a point of a module
    takes_off: IntArray  # (K - 1,) whether a leap begins
    effort: IntArray  # (2, K, 3) size of `pull`
    ever: IntArray  # (4, L) whether a side is ever held by an arm
    missed: IntArray  # (3,) distance of the box from its goal at the end


def columns_of(setting: Setting, table: LinearRows) -> Columns:
    """All variables with their bounds; those that modules latched at the start lack are fixed."""
    scene, K, L = setting.scene, setting.intervals, setting.scene.count
    low, high = setting.free[:, 0].min(axis=0), setting.free[:, 1].max(axis=0)
    most, moment = scene.module.max_force, scene.module.latch_moment
    several = len(setting.free) if len(setting.free) > 1 else 0
    centres = len(setting.centres) if len(setting.centres) > 1 else 0
    found = Columns(
        box=table.binaries((5, K)),
        legs=table.binaries((1,)),
        drives=table.binaries((L, K)),
        arm=table.binaries((L, K)),
        added=table.binaries((L, K)),
        leg=table.binaries((L, K)),
        hold=table.binaries((4, L, K)),
        mount=table.binaries((4, L, K)),
        wall=table.binaries((scene.walls, L, K)),
        carry=table.binaries((L, L, K)),
        ground=table.binaries((len(scene.patches), L, K)),
        region=table.binaries((several, 4, L, K + 1)),
        centre=table.binaries((centres, K)),
        position=table.columns((K + 1, 3), 0.0, 0.0),
        velocity=table.columns((K + 1, 3), -FASTEST, FASTEST),
        in_mode=table.columns((3, K, 3), -FASTEST, FASTEST),
        pull=table.columns((2, K, 3), -100.0, 100.0),
        force=table.columns((4, K, 3), -most, most),
        moment=table.columns((4, K, 3), -moment, moment),
        push=table.columns((L, K, 3), -most, most),
        points=table.columns((K + 1, L, POINTS, 3), 0.0, 0.0),
        moved=table.columns((L, K), 0.0, 10.0),
        takes_off=table.columns((K - 1,), 0.0, 1.0),
        effort=table.columns((2, K, 3), 0.0, 100.0),
        ever=table.columns((4, L), 0.0, 1.0),
        missed=table.columns((3,), 0.0, 100.0),
    )
    inner_low, inner_high = setting.centres[:, 0].min(axis=0), setting.centres[:, 1].max(axis=0)
    for axis in range(3):
        for column in found.position[:, axis]:
            table.bound(column, inner_low[axis], inner_high[axis])
        for column in found.points[..., axis].ravel():
            table.bound(column, low[axis], high[axis])
    _fix(setting, table, found)
    return found


def _fix(setting: Setting, table: LinearRows, columns: Columns) -> None:
    """What cannot be: fewer than four legs, arms that are not allowed, latched ones that leave."""
    scene = setting.scene
    latched = scene.held >= 0

    def never(numbers: IntArray) -> None:
        for column in np.ravel(numbers):
            table.bound(column, 0.0, 0.0)

    if "quadruped" not in scene.allow or (~latched).sum() < 4:
        never(columns.legs)
    if "arms" not in scene.allow or not scene.walls:
        table.bound(columns.legs[0], 1.0, 1.0)
    if "flight" not in scene.allow:
        never(columns.box[1])
        never(columns.box[4])
    if scene.arrival_speed == 0:
        never(columns.box[1])  # thrown boxes do not arrive at rest
    for module in range(scene.count):
        never(columns.carry[module, module])
        if latched[module]:
            for numbers in (columns.drives, columns.leg, columns.added):
                never(numbers[module])
            anchor = int(scene.held[module]) - scene.wall_offset
            for column in columns.wall[anchor, module]:
                table.bound(column, 1.0, 1.0)
        else:
            table.bound(columns.drives[module, 0], 1.0, 1.0)
    table.bound(columns.box[0, 0], 1.0, 1.0)
    _share_out(scene, columns, never)


def _share_out(scene: Scene, columns: Columns, never: Callable[[IntArray], None]) -> None:
    """Who may take which anchor and which side as a leg: modules are alike, least ways decide.

    Without it the search goes through permutations of the same plan.
    """
    modules = np.flatnonzero(scene.held < 0)
    if not len(modules):
        return
    walls = [w for w in range(scene.walls) if w + scene.wall_offset not in scene.held]
    places = scene.wall_position[walls]
    _keep_nearest(scene, columns.wall[walls], modules, places, never)
    for module in modules:
        for wall in set(range(scene.walls)) - set(walls):
            never(columns.wall[wall, module])
    sides = np.array([scene.box_start[0] + 3 * scene.side_offset(0, s) for s in range(4)])
    _keep_nearest(scene, columns.mount, modules, sides, never)


def _keep_nearest(
    scene: Scene,
    numbers: IntArray,
    modules: IntArray,
    places: Array,
    never: Callable[[IntArray], None],
) -> None:
    """Leave each place to one module (places, L, K): least ways together."""
    away = np.linalg.norm(places[:, None] - scene.stand[modules], axis=-1)
    rows, columns = linear_sum_assignment(away)
    owner = dict(zip(rows.tolist(), modules[columns].tolist(), strict=True))
    for place in range(len(places)):
        for module in range(scene.count):
            if owner.get(place) != module and module in modules:
                never(numbers[place, module])
