"""Rows for modules: latches, standing, speeds, links, and free space of links."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.columns import FASTEST, Columns
from climbplan.limms.consensus.setting import (
    LEAPS,
    LEVER,
    POINTS,
    Setting,
    start_points,
)
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.program.linear_rows import LinearRows, Number, Term

MARGIN = 0.05  # [m] of what stands from edges of the ground
AHEAD = 0.02  # [m] of a foot from its face of the box
_DIAGONALS = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))
_OCTAGON = float(np.cos(np.pi / 8))  # of a speed limit, which is a circle
_NEAR = {0: (0, 1), 1: (4, 3)}  # end -> its point, and the other point of its link


def add_modules(setting: Setting, table: LinearRows, columns: Columns) -> None:
    """Eqs. (6.1), (6.3) and (6.9), reach as planes round the balls of links, and speeds.

    The box does not turn, so that frames at latches are constant: the link there has the
    direction of the anchor's normal.
    """
    start = start_points(setting)
    for column, value in zip(columns.points[0].ravel(), start.ravel(), strict=True):
        table.bound(column, value, value)
    for m in range(setting.scene.count):
        for k in range(setting.intervals):
            for knot in (k, k + 1):
                _wall_latch(setting, table, columns, m, k, knot)
                _box_latch(setting, table, columns, m, k, knot, int(setting.box_end[m]), False)
                _box_latch(setting, table, columns, m, k, knot, 1, True)
                _standing(setting, table, columns, m, k, knot)
                for parent in range(setting.scene.count):
                    if parent != m:
                        _module_latch(setting, table, columns, parent, m, k, knot)
            _speeds(setting, table, columns, m, k)
        for knot in range(setting.knots):
            _links(setting, table, columns, m, knot)
            _free(setting, table, columns, m, knot)


def _reach(setting: Setting) -> float:
    """More than two points of the free space are apart along an axis [m]."""
    return float((setting.free[:, 1].max(axis=0) - setting.free[:, 0].min(axis=0)).max()) + 0.2


def _at(
    setting: Setting,
    table: LinearRows,
    name: str,
    point: IntArray,
    places: Array,
    chosen: IntArray,
    moving: IntArray | None = None,
) -> None:
    """point = moving + the chosen one of some places (n, 3), if one is chosen."""
    big = _reach(setting)
    for axis in range(3):
        terms: list[Term] = [(point[axis], 1.0)]
        if moving is not None:
            terms.append((moving[axis], -1.0))
        terms += [(b, -place) for b, place in zip(chosen, places[:, axis], strict=True)]
        # |terms| <= big * (1 - sum of chosen)
        table.within(name, terms, big, [(b, -1.0) for b in chosen], big)


def _bent(
    setting: Setting, table: LinearRows, points: IntArray, end: int, outward: Array, chosen: Number
) -> None:
    """The link next to a latched one no further back than its joint turns (points: (5, 3)).

    outward: direction of the latched link away from its latch, constant while `chosen` is 1.
    """
    if not setting.form.reach:
        return
    joint, length = (1, setting.links[1]) if end == 0 else (4, setting.links[2])
    least = float(np.cos(min(setting.scene.module.joint_range[joint], np.pi))) * length
    one, two = (1, 2) if end == 0 else (3, 2)
    terms: list[Term] = [
        term
        for axis in np.flatnonzero(outward)
        for term in ((points[two, axis], outward[axis]), (points[one, axis], -outward[axis]))
    ]
    slack = least + length
    table.row("joint.range", [*terms, (chosen, -slack)], least - slack, np.inf)


def _wall_latch(setting: Setting, table: LinearRows, c: Columns, m: int, k: int, knot: int) -> None:
    scene, end = setting.scene, int(setting.wall_end[m])
    if not scene.walls:
        return
    own, next_to = _NEAR[end]
    length = setting.links[0 if end == 0 else 3]
    chosen = c.wall[:, m, k]
    _at(setting, table, "latch.position", c.points[knot, m, own], scene.wall_position, chosen)
    inner = scene.wall_position + length * scene.wall_normal
    _at(setting, table, "latch.rotation", c.points[knot, m, next_to], inner, chosen)
    for normal, column in zip(scene.wall_normal, chosen, strict=True):
        _bent(setting, table, c.points[knot, m], end, normal, column)


def _box_latch(
    setting: Setting, table: LinearRows, c: Columns, m: int, k: int, knot: int, end: int, leg: bool
) -> None:
    scene = setting.scene
    own, next_to = _NEAR[end]
    length = setting.links[0 if end == 0 else 3]
    chosen = (c.mount if leg else c.hold)[:, m, k]
    offsets = np.array([scene.side_offset(0, side) for side in range(4)])
    moving = c.position[knot]
    _at(setting, table, "latch.position", c.points[knot, m, own], offsets, chosen, moving)
    _at(
        setting,
        table,
        "latch.rotation",
        c.points[knot, m, next_to],
        offsets + length * SIDE_NORMALS,
        chosen,
        moving,
    )
    for normal, column in zip(SIDE_NORMALS, chosen, strict=True):
        _bent(setting, table, c.points[knot, m], end, normal, column)
    if leg:  # each foot on its own side of the box, for the support polygon
        big = _reach(setting)
        for side in range(4):
            normal = SIDE_NORMALS[side]
            face = float(abs(normal) @ scene.box_size[0]) / 2 + AHEAD
            terms: list[Term] = [
                term
                for axis in np.flatnonzero(normal)
                for term in (
                    (c.points[knot, m, 0, axis], normal[axis]),
                    (moving[axis], -normal[axis]),
                )
            ]
            table.row("support.sides", [*terms, (c.mount[side, m, k], -big - face)], -big, np.inf)


def _module_latch(
    setting: Setting, table: LinearRows, c: Columns, parent: int, child: int, k: int, knot: int
) -> None:
    """The child's last end on the end that the parent would hold the box with, in line with it."""
    end = int(setting.box_end[parent])
    own, next_to = _NEAR[end]
    theirs, mine = c.points[knot, parent], c.points[knot, child]
    chosen = np.array([c.carry[parent, child, k]])
    big = _reach(setting)
    ratio = setting.links[3] / setting.links[0 if end == 0 else 3]
    for axis in range(3):
        opened: list[Term] = [(b, -1.0) for b in chosen]
        table.within(
            "latch.position", [(mine[4, axis], 1), (theirs[own, axis], -1)], big, opened, big
        )
        # mine[4] - mine[3] is opposite to the parent's own way out of its end
        line: list[Term] = [
            (mine[4, axis], 1),
            (mine[3, axis], -1),
            (theirs[next_to, axis], -ratio),
            (theirs[own, axis], ratio),
        ]
        table.within("latch.rotation", line, big, opened, big)


def _standing(setting: Setting, table: LinearRows, c: Columns, m: int, k: int, knot: int) -> None:
    """Upright if it drives or is a leg; the first end on a patch of the ground where it stands."""
    scene, big = setting.scene, _reach(setting)
    first, second = c.points[knot, m, 0], c.points[knot, m, 1]
    upright: list[Term] = [(c.drives[m, k], -1.0), (c.leg[m, k], -1.0)]
    for axis in range(3):
        terms: list[Term] = [(second[axis], 1), (first[axis], -1)]
        rise = setting.links[0] if axis == 2 else 0.0
        both = [*terms, *((column, v * rise) for column, v in upright)]
        table.within("ground.stand", both, big, upright, big)
    up = np.array([0.0, 0.0, 1.0])
    for column, _ in upright:
        _bent(setting, table, c.points[knot, m], 0, up, column)
    here = c.ground[:, m, k]
    for axis in range(3):
        lows = [p.height if axis == 2 else p.lower[axis] + MARGIN for p in scene.patches]
        highs = [p.height if axis == 2 else p.upper[axis] - MARGIN for p in scene.patches]
        least = float(setting.free[:, 0, axis].min())
        most = float(setting.free[:, 1, axis].max())
        # Without a patch: anywhere in the free space
        table.row(
            "ground.stand",
            [(first[axis], 1), *((b, least - v) for b, v in zip(here, lows, strict=True))],
            least,
            np.inf,
        )
        table.at_most(
            "ground.stand",
            [(first[axis], 1), *((b, most - v) for b, v in zip(here, highs, strict=True))],
            most,
        )


def _speeds(setting: Setting, table: LinearRows, c: Columns, m: int, k: int) -> None:
    """Eq. (6.9); feet stand still; the other points no faster than joints move them."""
    module, big = setting.scene.module, _reach(setting)
    lasts: list[Term] = list(zip(c.box[:, k], setting.form.seconds, strict=True))
    fast, slow = LEVER * module.max_joint_speed, _OCTAGON * module.ground_speed
    moved = c.moved[m, k]
    # In a leap everything flies with the box
    flies = (c.box[LEAPS, k], -(FASTEST - fast) * setting.form.seconds[LEAPS])
    if setting.form.reach:
        most: list[Term] = [(moved, 1.0), *((column, -fast * h) for column, h in lasts), flies]
        table.at_most("joint.speed", most)
    steps: list[list[Term]] = []
    for point in range(POINTS):
        for axis in range(3):
            ends = c.points[k + 1, m, point, axis], c.points[k, m, point, axis]
            step: list[Term] = [(ends[0], 1), (ends[1], -1)]
            table.at_most("joint.speed", [*step, (moved, -1)])
            table.at_most("joint.speed", [*_minus(step), (moved, -1)])
            if not point:
                steps.append(step)
    drives: list[Term] = [(c.drives[m, k], big), *((column, -slow * h) for column, h in lasts)]
    for along, across in ((1.0, 0.0), (0.0, 1.0), (0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5))):
        way = [(column, along * v) for column, v in steps[0]]
        way += [(column, across * v) for column, v in steps[1]]
        table.at_most("ground.speed", [*way, *drives], big)
        table.at_most("ground.speed", [*_minus(way), *drives], big)
    level: list[Term] = [(c.drives[m, k], big)]  # it does not climb
    table.at_most("ground.speed", [*steps[2], *level], big)
    table.at_most("ground.speed", [*_minus(steps[2]), *level], big)
    still: list[Term] = [(column, big) for column in c.ground[:, m, k]]
    still.append((c.drives[m, k], -big))
    for step in steps[:2]:
        table.at_most("ground.speed", [*step, *still], big)
        table.at_most("ground.speed", [*_minus(step), *still], big)


def _minus(terms: list[Term]) -> list[Term]:
    return [(column, -value) for column, value in terms]


def _links(setting: Setting, table: LinearRows, c: Columns, m: int, knot: int) -> None:
    """Ends of each link no further apart than it is long: planes round the ball."""
    if not setting.form.reach:
        return
    for i, length in enumerate(setting.links):
        ends = c.points[knot, m, i], c.points[knot, m, i + 1]
        apart = [[(ends[1][axis], 1.0), (ends[0][axis], -1.0)] for axis in range(3)]
        for axis in range(3):
            table.row("kinematics.points", apart[axis], -length, length)
        for signs in _DIAGONALS:
            terms = [
                (column, v * sign) for axis, sign in enumerate(signs) for column, v in apart[axis]
            ]
            table.row("kinematics.points", terms, -(3**0.5) * length, 3**0.5 * length)


def _free(setting: Setting, table: LinearRows, c: Columns, m: int, knot: int) -> None:
    """Each link in one free block, one radius inside but for the ends."""
    radius = setting.scene.module.radius
    for i in range(POINTS - 1):
        chosen = c.region[:, i, m, knot]
        if len(chosen):
            table.equal("clear.solids", [(b, 1.0) for b in chosen], 1.0)
        for point in (i, i + 1):
            margin = 0.0 if point in (0, POINTS - 1) else radius
            for axis in range(3):
                column = c.points[knot, m, point, axis]
                if not len(chosen):
                    low, high = setting.free[0, :, axis]
                    if knot:
                        table.bound(column, low + margin, high - margin)
                    continue
                lows = [
                    (b, -low - margin)
                    for b, low in zip(chosen, setting.free[:, 0, axis], strict=True)
                ]
                highs = [
                    (b, margin - high)
                    for b, high in zip(chosen, setting.free[:, 1, axis], strict=True)
                ]
                table.row("clear.solids", [(column, 1), *lows], 0.0, np.inf)
                table.at_most("clear.solids", [(column, 1), *highs])
