"""The variables of the mixed-integer block, by their meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.problem import POINTS, ConsensusProblem
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.program.linear_rows import LinearRows

MAX_BOX_SPEED = 6.0  # [m/s], bound on the box


@dataclass(frozen=True)
class VariableColumns:
    """Column indices; K intervals, L modules, W anchors, P patches, R free blocks."""

    box: IntArray  # (5, K) z_B: mode of the box, as in `problem`
    uses_legs: IntArray  # (1,) the box walks; else it is held or thrown
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
    acceleration: IntArray  # (2, K, 3) acceleration where held, standing
    force: IntArray  # (4, K, 3) of arms at the sides of the box
    moment: IntArray  # (4, K, 3) of latches
    foot_force: IntArray  # (L, K, 3) of feet
    points: IntArray  # (K + 1, L, 5, 3) p_L
    path_bound: IntArray  # (L, K) largest displacement of a point of a module
    takes_off: IntArray  # (K - 1,) a leap starts
    abs_acceleration: IntArray  # (2, K, 3) absolute value of `acceleration`
    is_ever_held: IntArray  # (4, L) a side is held by an arm in some interval
    goal_error: IntArray  # (3,) distance of the box from its goal at the end


def add_variables(problem: ConsensusProblem, table: LinearRows) -> VariableColumns:
    """Add all variables with their bounds to a table, and return their columns."""
    scene, K, L = problem.scene, problem.intervals, problem.scene.num_modules
    lower, upper = problem.free_blocks[:, 0].min(axis=0), problem.free_blocks[:, 1].max(axis=0)
    max_force, max_moment = scene.module.max_force, scene.module.latch_moment
    num_blocks = len(problem.free_blocks) if len(problem.free_blocks) > 1 else 0
    num_centre_blocks = len(problem.centre_blocks) if len(problem.centre_blocks) > 1 else 0
    columns = VariableColumns(
        box=table.binaries((5, K)),
        uses_legs=table.binaries((1,)),
        drives=table.binaries((L, K)),
        arm=table.binaries((L, K)),
        added=table.binaries((L, K)),
        leg=table.binaries((L, K)),
        hold=table.binaries((4, L, K)),
        mount=table.binaries((4, L, K)),
        wall=table.binaries((scene.num_wall_anchors, L, K)),
        carry=table.binaries((L, L, K)),
        ground=table.binaries((len(scene.patches), L, K)),
        region=table.binaries((num_blocks, 4, L, K + 1)),
        centre=table.binaries((num_centre_blocks, K)),
        position=table.columns((K + 1, 3), 0.0, 0.0),
        velocity=table.columns((K + 1, 3), -MAX_BOX_SPEED, MAX_BOX_SPEED),
        in_mode=table.columns((3, K, 3), -MAX_BOX_SPEED, MAX_BOX_SPEED),
        acceleration=table.columns((2, K, 3), -100.0, 100.0),
        force=table.columns((4, K, 3), -max_force, max_force),
        moment=table.columns((4, K, 3), -max_moment, max_moment),
        foot_force=table.columns((L, K, 3), -max_force, max_force),
        points=table.columns((K + 1, L, POINTS, 3), 0.0, 0.0),
        path_bound=table.columns((L, K), 0.0, 10.0),
        takes_off=table.columns((K - 1,), 0.0, 1.0),
        abs_acceleration=table.columns((2, K, 3), 0.0, 100.0),
        is_ever_held=table.columns((4, L), 0.0, 1.0),
        goal_error=table.columns((3,), 0.0, 100.0),
    )
    inner_low, inner_high = (
        problem.centre_blocks[:, 0].min(axis=0),
        problem.centre_blocks[:, 1].max(axis=0),
    )
    for axis in range(3):
        for column in columns.position[:, axis]:
            table.bound(column, inner_low[axis], inner_high[axis])
        for column in columns.points[..., axis].ravel():
            table.bound(column, lower[axis], upper[axis])
    _fix_impossible(problem, table, columns)
    return columns


def _fix_impossible(problem: ConsensusProblem, table: LinearRows, columns: VariableColumns) -> None:
    """Fix variables that cannot be one: legs without four modules, arms not allowed, latched
    modules.
    """
    scene = problem.scene
    latched = scene.start_anchor >= 0

    def fix_at_zero(numbers: IntArray) -> None:
        for column in np.ravel(numbers):
            table.bound(column, 0.0, 0.0)

    if "quadruped" not in scene.allow or (~latched).sum() < 4:
        fix_at_zero(columns.uses_legs)
    if "arms" not in scene.allow or not scene.num_wall_anchors:
        table.bound(columns.uses_legs[0], 1.0, 1.0)
    if "flight" not in scene.allow:
        fix_at_zero(columns.box[1])
        fix_at_zero(columns.box[4])
    if scene.arrival_speed == 0:
        fix_at_zero(columns.box[1])  # thrown boxes do not arrive at rest
    for module in range(scene.num_modules):
        fix_at_zero(columns.carry[module, module])
        if latched[module]:
            for numbers in (columns.drives, columns.leg, columns.added):
                fix_at_zero(numbers[module])
            anchor = int(scene.start_anchor[module]) - scene.wall_offset
            for column in columns.wall[anchor, module]:
                table.bound(column, 1.0, 1.0)
        else:
            table.bound(columns.drives[module, 0], 1.0, 1.0)
    table.bound(columns.box[0, 0], 1.0, 1.0)
    _assign_modules(scene, columns, fix_at_zero)


def _assign_modules(
    scene: ModuleScene, columns: VariableColumns, fix_at_zero: Callable[[IntArray], None]
) -> None:
    """Assign anchors and leg sides to the nearest modules, to break the symmetry of equal modules.

    Without the assignment, the search enumerates permutations of the same plan.
    """
    modules = np.flatnonzero(scene.start_anchor < 0)
    if not len(modules):
        return
    walls = [
        w for w in range(scene.num_wall_anchors) if w + scene.wall_offset not in scene.start_anchor
    ]
    positions = scene.wall_position[walls]
    _keep_nearest(scene, columns.wall[walls], modules, positions, fix_at_zero)
    for module in modules:
        for wall in set(range(scene.num_wall_anchors)) - set(walls):
            fix_at_zero(columns.wall[wall, module])
    sides = np.array([scene.box_start[0] + 3 * scene.side_offset(0, s) for s in range(4)])
    _keep_nearest(scene, columns.mount, modules, sides, fix_at_zero)


def _keep_nearest(
    scene: ModuleScene,
    numbers: IntArray,
    modules: IntArray,
    positions: Array,
    fix_at_zero: Callable[[IntArray], None],
) -> None:
    """Leave each place to one module by an assignment of least total distance.

    Args:
        scene: The scene.
        numbers: Columns by place, module and interval (places, L, K).
        modules: Modules that may be assigned.
        positions: Positions of the places (places, 3) [m].
        fix_at_zero: Fixes columns at zero.
    """
    distances = np.linalg.norm(positions[:, None] - scene.start_position[modules], axis=-1)
    rows, columns = linear_sum_assignment(distances)
    owner = dict(zip(rows.tolist(), modules[columns].tolist(), strict=True))
    for target in range(len(positions)):
        for module in range(scene.num_modules):
            if owner.get(target) != module and module in modules:
                fix_at_zero(numbers[target, module])
