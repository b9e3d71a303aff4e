"""Linear rows for modules: latches, standing, speeds, link lengths and free space.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.problem import (
    LEAPS,
    MAX_LEVER_ARM,
    POINTS,
    ConsensusProblem,
    compute_start_points,
)
from climbplan.limms.consensus.variables import MAX_BOX_SPEED, VariableColumns
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.program.linear_rows import LinearRows, Number, Term

GROUND_MARGIN = 0.05  # [m] of standing modules from edges of the ground
FOOT_CLEARANCE = 0.02  # [m] of a foot in front of its face of the box
_DIAGONALS = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))
_OCTAGON = float(np.cos(np.pi / 8))  # inscribed octagon of a circular speed limit
_END_POINTS = {0: (0, 1), 1: (4, 3)}  # end: its point, and the next point of its link


def add_module_rows(problem: ConsensusProblem, table: LinearRows, columns: VariableColumns) -> None:
    """Add eqs. (6.1), (6.3) and (6.9), reach as planes around balls of links, and speeds.

    The box does not turn, so frames at latches are constant: the latched link has the direction of
    the anchor's normal.
    """
    start = compute_start_points(problem)
    for column, value in zip(columns.points[0].ravel(), start.ravel(), strict=True):
        table.bound(column, value, value)
    for m in range(problem.scene.num_modules):
        for k in range(problem.intervals):
            for knot in (k, k + 1):
                _add_wall_latch(problem, table, columns, m, k, knot)
                box_end = int(problem.box_end[m])
                _add_box_latch(problem, table, columns, m, k, knot, end=box_end, is_leg=False)
                _add_box_latch(problem, table, columns, m, k, knot, end=1, is_leg=True)
                _add_standing(problem, table, columns, m, k, knot)
                for parent in range(problem.scene.num_modules):
                    if parent != m:
                        _add_module_latch(problem, table, columns, k, knot, parent=parent, child=m)
            _add_speeds(problem, table, columns, m, k)
        for knot in range(problem.knots):
            _add_link_lengths(problem, table, columns, m, knot)
            _add_free_space(problem, table, columns, m, knot)


def _big_m(problem: ConsensusProblem) -> float:
    """Return the big-M constant: a bound on distances along an axis in the free space [m]."""
    return (
        float((problem.free_blocks[:, 1].max(axis=0) - problem.free_blocks[:, 0].min(axis=0)).max())
        + 0.2
    )


def _add_position_choice(
    problem: ConsensusProblem,
    table: LinearRows,
    name: str,
    point: IntArray,
    positions: Array,
    chosen: IntArray,
    *,
    origin: IntArray | None = None,
) -> None:
    """Add point = origin + the chosen one of some positions (n, 3), if one is chosen."""
    big_m = _big_m(problem)
    for axis in range(3):
        terms: list[Term] = [(point[axis], 1.0)]
        if origin is not None:
            terms.append((origin[axis], -1.0))
        terms += [(b, -position) for b, position in zip(chosen, positions[:, axis], strict=True)]
        # |terms| <= big * (1 - sum of chosen)
        table.within(name, terms, big_m, [(b, -1.0) for b in chosen], big_m)


def _add_joint_range(
    problem: ConsensusProblem,
    table: LinearRows,
    points: IntArray,
    end: int,
    outward: Array,
    chosen: Number,
) -> None:
    """Add the joint range between a latched link and the next one.

    Args:
        problem: The problem.
        table: Receives the row.
        points: Columns of the module's points (5, 3).
        end: The latched end.
        outward: Direction of the latched link away from its latch.
        chosen: Column that is 1 while the end is latched.
    """
    if not problem.formulation.has_kinematics:
        return
    joint, length = (1, problem.link_lengths[1]) if end == 0 else (4, problem.link_lengths[2])
    min_projection = float(np.cos(min(problem.scene.module.joint_range[joint], np.pi))) * length
    inner_point, outer_point = (1, 2) if end == 0 else (3, 2)
    terms: list[Term] = [
        term
        for axis in np.flatnonzero(outward)
        for term in (
            (points[outer_point, axis], outward[axis]),
            (points[inner_point, axis], -outward[axis]),
        )
    ]
    slack = min_projection + length
    table.row("kinematics.joint_bounds", [*terms, (chosen, -slack)], min_projection - slack, np.inf)


def _add_wall_latch(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, m: int, k: int, knot: int
) -> None:
    """Add position and direction of the link of a module on a terrain anchor."""
    scene, end = problem.scene, int(problem.wall_end[m])
    if not scene.num_wall_anchors:
        return
    end_point, next_point = _END_POINTS[end]
    length = problem.link_lengths[0 if end == 0 else 3]
    chosen = c.wall[:, m, k]
    _add_position_choice(
        problem, table, "latch.position", c.points[knot, m, end_point], scene.wall_position, chosen
    )
    inner_positions = scene.wall_position + length * scene.wall_normal
    _add_position_choice(
        problem, table, "latch.rotation", c.points[knot, m, next_point], inner_positions, chosen
    )
    for normal, column in zip(scene.wall_normal, chosen, strict=True):
        _add_joint_range(problem, table, c.points[knot, m], end, normal, column)


def _add_box_latch(
    problem: ConsensusProblem,
    table: LinearRows,
    c: VariableColumns,
    m: int,
    k: int,
    knot: int,
    *,
    end: int,
    is_leg: bool,
) -> None:
    """Add position and direction of the link of a module on a side of the box."""
    scene = problem.scene
    end_point, next_point = _END_POINTS[end]
    length = problem.link_lengths[0 if end == 0 else 3]
    chosen = (c.mount if is_leg else c.hold)[:, m, k]
    offsets = np.array([scene.side_offset(0, side) for side in range(4)])
    box_position = c.position[knot]
    _add_position_choice(
        problem,
        table,
        "latch.position",
        c.points[knot, m, end_point],
        offsets,
        chosen,
        origin=box_position,
    )
    _add_position_choice(
        problem,
        table,
        "latch.rotation",
        c.points[knot, m, next_point],
        offsets + length * SIDE_NORMALS,
        chosen,
        origin=box_position,
    )
    for normal, column in zip(SIDE_NORMALS, chosen, strict=True):
        _add_joint_range(problem, table, c.points[knot, m], end, normal, column)
    if is_leg:  # each foot on its side of the box, for the support polygon
        big_m = _big_m(problem)
        for side in range(4):
            normal = SIDE_NORMALS[side]
            face = float(abs(normal) @ scene.box_size[0]) / 2 + FOOT_CLEARANCE
            terms: list[Term] = [
                term
                for axis in np.flatnonzero(normal)
                for term in (
                    (c.points[knot, m, 0, axis], normal[axis]),
                    (box_position[axis], -normal[axis]),
                )
            ]
            table.row(
                "support.sides", [*terms, (c.mount[side, m, k], -big_m - face)], -big_m, np.inf
            )


def _add_module_latch(
    problem: ConsensusProblem,
    table: LinearRows,
    c: VariableColumns,
    k: int,
    knot: int,
    *,
    parent: int,
    child: int,
) -> None:
    """Add the latch of a child's last end, in line, on the end of its parent that holds boxes."""
    end = int(problem.box_end[parent])
    end_point, next_point = _END_POINTS[end]
    parent_points, child_points = c.points[knot, parent], c.points[knot, child]
    chosen = np.array([c.carry[parent, child, k]])
    big_m = _big_m(problem)
    ratio = problem.link_lengths[3] / problem.link_lengths[0 if end == 0 else 3]
    for axis in range(3):
        is_latched: list[Term] = [(b, -1.0) for b in chosen]
        table.within(
            "latch.position",
            [(child_points[4, axis], 1), (parent_points[end_point, axis], -1)],
            big_m,
            is_latched,
            big_m,
        )
        # child[4] - child[3] is opposite to the parent's link at that end
        line: list[Term] = [
            (child_points[4, axis], 1),
            (child_points[3, axis], -1),
            (parent_points[next_point, axis], -ratio),
            (parent_points[end_point, axis], ratio),
        ]
        table.within("latch.rotation", line, big_m, is_latched, big_m)


def _add_standing(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, m: int, k: int, knot: int
) -> None:
    """Add the upright link of driving modules and legs, and the patch under the first end."""
    scene, big_m = problem.scene, _big_m(problem)
    first, second = c.points[knot, m, 0], c.points[knot, m, 1]
    is_upright: list[Term] = [(c.drives[m, k], -1.0), (c.leg[m, k], -1.0)]
    for axis in range(3):
        terms: list[Term] = [(second[axis], 1), (first[axis], -1)]
        rise = problem.link_lengths[0] if axis == 2 else 0.0
        both = [*terms, *((column, v * rise) for column, v in is_upright)]
        table.within("ground.contact", both, big_m, is_upright, big_m)
    vertical = np.array([0.0, 0.0, 1.0])
    for column, _ in is_upright:
        _add_joint_range(problem, table, c.points[knot, m], 0, vertical, column)
    on_patch = c.ground[:, m, k]
    for axis in range(3):
        lows = [p.height if axis == 2 else p.lower[axis] + GROUND_MARGIN for p in scene.patches]
        highs = [p.height if axis == 2 else p.upper[axis] - GROUND_MARGIN for p in scene.patches]
        lowest = float(problem.free_blocks[:, 0, axis].min())
        highest = float(problem.free_blocks[:, 1, axis].max())
        # Without a patch: anywhere in the free space
        table.row(
            "ground.contact",
            [(first[axis], 1), *((b, lowest - v) for b, v in zip(on_patch, lows, strict=True))],
            lowest,
            np.inf,
        )
        table.at_most(
            "ground.contact",
            [(first[axis], 1), *((b, highest - v) for b, v in zip(on_patch, highs, strict=True))],
            highest,
        )


def _add_speeds(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, m: int, k: int
) -> None:
    """Add eq. (6.9): feet stand still, other points move no faster than joints move them."""
    module, big_m = problem.scene.module, _big_m(problem)
    duration: list[Term] = list(zip(c.box[:, k], problem.formulation.interval_seconds, strict=True))
    fast, slow = MAX_LEVER_ARM * module.max_joint_speed, _OCTAGON * module.ground_speed
    path_bound = c.path_bound[m, k]
    # In a leap the modules fly with the box
    in_leap = (
        c.box[LEAPS, k],
        -(MAX_BOX_SPEED - fast) * problem.formulation.interval_seconds[LEAPS],
    )
    if problem.formulation.has_kinematics:
        path_limit: list[Term] = [
            (path_bound, 1.0),
            *((column, -fast * h) for column, h in duration),
            in_leap,
        ]
        table.at_most("speed.limit", path_limit)
    steps: list[list[Term]] = []
    for point in range(POINTS):
        for axis in range(3):
            ends = c.points[k + 1, m, point, axis], c.points[k, m, point, axis]
            step: list[Term] = [(ends[0], 1), (ends[1], -1)]
            table.at_most("speed.limit", [*step, (path_bound, -1)])
            table.at_most("speed.limit", [*_negate(step), (path_bound, -1)])
            if not point:
                steps.append(step)
    drives: list[Term] = [(c.drives[m, k], big_m), *((column, -slow * h) for column, h in duration)]
    for cos, sin in ((1.0, 0.0), (0.0, 1.0), (0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5))):
        displacement = [(column, cos * v) for column, v in steps[0]]
        displacement += [(column, sin * v) for column, v in steps[1]]
        table.at_most("ground.speed", [*displacement, *drives], big_m)
        table.at_most("ground.speed", [*_negate(displacement), *drives], big_m)
    horizontal: list[Term] = [(c.drives[m, k], big_m)]  # a driving module stays level
    table.at_most("ground.speed", [*steps[2], *horizontal], big_m)
    table.at_most("ground.speed", [*_negate(steps[2]), *horizontal], big_m)
    standing: list[Term] = [(column, big_m) for column in c.ground[:, m, k]]
    standing.append((c.drives[m, k], -big_m))
    for step in steps[:2]:
        table.at_most("ground.speed", [*step, *standing], big_m)
        table.at_most("ground.speed", [*_negate(step), *standing], big_m)


def _negate(terms: list[Term]) -> list[Term]:
    """Return the terms with opposite signs."""
    return [(column, -value) for column, value in terms]


def _add_link_lengths(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, m: int, knot: int
) -> None:
    """Add the length of each link: its ends are within planes around a ball."""
    if not problem.formulation.has_kinematics:
        return
    for i, length in enumerate(problem.link_lengths):
        ends = c.points[knot, m, i], c.points[knot, m, i + 1]
        differences = [[(ends[1][axis], 1.0), (ends[0][axis], -1.0)] for axis in range(3)]
        for axis in range(3):
            table.row("kinematics.forward", differences[axis], -length, length)
        for signs in _DIAGONALS:
            terms = [
                (column, v * sign)
                for axis, sign in enumerate(signs)
                for column, v in differences[axis]
            ]
            table.row("kinematics.forward", terms, -(3**0.5) * length, 3**0.5 * length)


def _add_free_space(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, m: int, knot: int
) -> None:
    """Add each link in one free block, one radius inside except at its ends."""
    radius = problem.scene.module.radius
    for i in range(POINTS - 1):
        chosen = c.region[:, i, m, knot]
        if len(chosen):
            table.equal("limbs.collision", [(b, 1.0) for b in chosen], 1.0)
        for point in (i, i + 1):
            margin = 0.0 if point in (0, POINTS - 1) else radius
            for axis in range(3):
                column = c.points[knot, m, point, axis]
                if not len(chosen):
                    low, high = problem.free_blocks[0, :, axis]
                    if knot:
                        table.bound(column, low + margin, high - margin)
                    continue
                lows = [
                    (b, -low - margin)
                    for b, low in zip(chosen, problem.free_blocks[:, 0, axis], strict=True)
                ]
                highs = [
                    (b, margin - high)
                    for b, high in zip(chosen, problem.free_blocks[:, 1, axis], strict=True)
                ]
                table.row("limbs.collision", [(column, 1), *lows], 0.0, np.inf)
                table.at_most("limbs.collision", [(column, 1), *highs])
