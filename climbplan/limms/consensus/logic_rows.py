"""Rows for the logic rules of Table 6.2, and for latches that stay closed."""

from __future__ import annotations

from climbplan.limms.consensus.columns import Columns
from climbplan.limms.consensus.setting import FREE, HELD, LEAPS, STABLE, STANDS, Setting
from climbplan.program.linear_rows import LinearRows, Term


def add_logic(setting: Setting, table: LinearRows, columns: Columns) -> None:
    """Rules 1 to 12 in each interval, as tight equalities where loops of rules imply them.

    As in `limms.logic`, an added arm has one parent, which carries one child and holds no box.
    Parents are arms: chains of three, which rule 10 admits, are left out.
    """
    for k in range(setting.intervals):
        _interval(setting, table, columns, k)
    _stays(setting, table, columns)


def _interval(setting: Setting, table: LinearRows, c: Columns, k: int) -> None:
    L, W = setting.scene.count, setting.scene.walls
    modules, sides = range(L), range(4)
    ones: list[Term] = [(column, 1.0) for column in c.box[:, k]]
    table.equal("logic.box_mode", ones, 1.0)
    # A box walks or is held, not both in one plan
    table.at_most("logic.behaviour", [(c.box[STANDS, k], 1), (c.box[LEAPS, k], 1), (c.legs[0], -1)])
    table.at_most(
        "logic.behaviour", [(c.box[HELD, k], 1), (c.box[FREE, k], 1), (c.legs[0], 1)], 1.0
    )
    for s in sides:
        # 1 and 2: all sides have legs exactly where the box is a quadruped
        legs: list[Term] = [(c.mount[s, m, k], 1) for m in modules]
        table.equal("logic.rule_1", [*legs, (c.box[STANDS, k], -1), (c.box[LEAPS, k], -1)])
        # 12, and each side holds one module
        table.at_most(
            "logic.rule_12", [*((c.hold[s, m, k], 1) for m in modules), (c.box[HELD, k], -1)]
        )
    # 5
    held: list[Term] = [(c.hold[s, m, k], -1) for s in sides for m in modules]
    table.at_most("logic.rule_5", [(c.box[HELD, k], 1), *held])
    for m in modules:
        table.equal(
            "logic.module_mode", [(v[m, k], 1) for v in (c.drives, c.arm, c.added, c.leg)], 1.0
        )
        # 3 and 4
        table.equal("logic.rule_3", [*((c.mount[s, m, k], 1) for s in sides), (c.leg[m, k], -1)])
        # 6
        mine: list[Term] = [(c.hold[s, m, k], 1) for s in sides]
        table.at_most("logic.rule_6", [*mine, (c.arm[m, k], -1), (c.added[m, k], -1)])
        # 7 and 8
        table.equal("logic.rule_7", [*((c.wall[w, m, k], 1) for w in range(W)), (c.arm[m, k], -1)])
        # 9
        table.equal(
            "logic.rule_9", [*((c.carry[p, m, k], 1) for p in modules), (c.added[m, k], -1)]
        )
        # 10 and 11
        children: list[Term] = [(c.carry[m, child, k], 1) for child in modules]
        table.at_most("logic.rule_11", [*children, *mine], 1.0)
        table.at_most("logic.rule_10", [*children, (c.arm[m, k], -1)])
        # A module that drives stands, a leg may, an arm does not
        stands: list[Term] = [(c.ground[p, m, k], 1) for p in range(len(setting.scene.patches))]
        table.at_most("ground.free", [*stands, (c.drives[m, k], -1), (c.leg[m, k], -1)])
        table.at_most("ground.free", [(c.drives[m, k], 1), *((column, -v) for column, v in stands)])
        # In the air no foot stands; else all do, so that the support polygon is that of four
        table.at_most("ground.feet", [*stands, (c.box[LEAPS, k], 1), (c.drives[m, k], -1)], 1.0)
        feet: list[Term] = [(column, -v) for column, v in stands]
        table.at_most("ground.feet", [(c.leg[m, k], 1), (c.box[LEAPS, k], -1), *feet])
    for w in range(W):
        table.at_most("logic.anchors", [(c.wall[w, m, k], 1) for m in modules], 1.0)


def _stays(setting: Setting, table: LinearRows, c: Columns) -> None:
    """Continuity of connections: latches to terrain, modules and as legs stay to the end.

    Arms take the box at once and let it go at once, and a quadruped leaps once at most: what the
    refinement carries out.
    """
    for k in range(setting.intervals):
        for now, ever in zip(c.hold[..., k].ravel(), c.ever.ravel(), strict=True):
            table.at_most("latch.stays", [(now, 1), (ever, -1)])
    for k in range(setting.intervals - 1):
        table.at_most("box.once", [(c.box[STABLE, k + 1], 1), (c.box[STABLE, k], -1)])
        table.at_most("box.once", [(c.box[FREE, k], 1), (c.box[FREE, k + 1], -1)])
        for numbers in (c.wall, c.carry, c.mount):
            for now, then in zip(numbers[..., k].ravel(), numbers[..., k + 1].ravel(), strict=True):
                table.at_most("latch.stays", [(now, 1), (then, -1)])
        for now, then in zip(c.hold[..., k].ravel(), c.hold[..., k + 1].ravel(), strict=True):
            table.at_most("latch.stays", [(now, 1), (then, -1), (c.box[HELD, k + 1], 1)], 1.0)
            table.at_most("latch.stays", [(then, 1), (now, -1), (c.box[HELD, k], 1)], 1.0)
        leaps: list[Term] = [(c.box[LEAPS, k + 1], 1), (c.box[LEAPS, k], -1)]
        table.at_most("box.one_leap", [*leaps, (c.takes_off[k], -1)])
    table.at_most("box.one_leap", [(column, 1) for column in c.takes_off], 1.0)
