"""Linear rows for the logic rules of Table 6.2, and for the continuity of latches.

Table numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from climbplan.limms.consensus.problem import FREE, HELD, LEAPS, STABLE, STANDS, ConsensusProblem
from climbplan.limms.consensus.variables import VariableColumns
from climbplan.program.linear_rows import LinearRows, Term


def add_logic_rows(problem: ConsensusProblem, table: LinearRows, columns: VariableColumns) -> None:
    """Add rules 1 to 12 in each interval, as equalities where several rules imply them.

    As in `check/logic.py`, an added arm has one parent, which carries one child and holds no box.
    Parents are arms: chains of three, which rule 10 allows, are left out.
    """
    for k in range(problem.intervals):
        _add_rules(problem, table, columns, k)
    _add_continuity(problem, table, columns)


def _add_rules(problem: ConsensusProblem, table: LinearRows, c: VariableColumns, k: int) -> None:
    """Add the rules of one interval."""
    L, W = problem.scene.num_modules, problem.scene.num_wall_anchors
    modules, sides = range(L), range(4)
    box_modes: list[Term] = [(column, 1.0) for column in c.box[:, k]]
    table.equal("logic.box_mode", box_modes, 1.0)
    # A box walks or is held, not both in one plan
    table.at_most(
        "logic.behaviour", [(c.box[STANDS, k], 1), (c.box[LEAPS, k], 1), (c.uses_legs[0], -1)]
    )
    table.at_most(
        "logic.behaviour", [(c.box[HELD, k], 1), (c.box[FREE, k], 1), (c.uses_legs[0], 1)], 1.0
    )
    for s in sides:
        # 1 and 2: all sides have legs exactly where the box is a quadruped
        mounted: list[Term] = [(c.mount[s, m, k], 1) for m in modules]
        table.equal("logic.rule_1", [*mounted, (c.box[STANDS, k], -1), (c.box[LEAPS, k], -1)])
        # 12, and each side holds one module
        table.at_most(
            "logic.rule_12", [*((c.hold[s, m, k], 1) for m in modules), (c.box[HELD, k], -1)]
        )
    # 5
    holding: list[Term] = [(c.hold[s, m, k], -1) for s in sides for m in modules]
    table.at_most("logic.rule_5", [(c.box[HELD, k], 1), *holding])
    for m in modules:
        table.equal(
            "logic.module_mode", [(v[m, k], 1) for v in (c.drives, c.arm, c.added, c.leg)], 1.0
        )
        # 3 and 4
        table.equal("logic.rule_3", [*((c.mount[s, m, k], 1) for s in sides), (c.leg[m, k], -1)])
        # 6
        own_sides: list[Term] = [(c.hold[s, m, k], 1) for s in sides]
        table.at_most("logic.rule_6", [*own_sides, (c.arm[m, k], -1), (c.added[m, k], -1)])
        # 7 and 8
        table.equal("logic.rule_7", [*((c.wall[w, m, k], 1) for w in range(W)), (c.arm[m, k], -1)])
        # 9
        table.equal(
            "logic.rule_9", [*((c.carry[p, m, k], 1) for p in modules), (c.added[m, k], -1)]
        )
        # 10 and 11
        children: list[Term] = [(c.carry[m, child, k], 1) for child in modules]
        table.at_most("logic.rule_11", [*children, *own_sides], 1.0)
        table.at_most("logic.rule_10", [*children, (c.arm[m, k], -1)])
        # A driving module stands, a leg may stand, an arm does not
        standing: list[Term] = [(c.ground[p, m, k], 1) for p in range(len(problem.scene.patches))]
        table.at_most("ground.support", [*standing, (c.drives[m, k], -1), (c.leg[m, k], -1)])
        table.at_most(
            "ground.support", [(c.drives[m, k], 1), *((column, -v) for column, v in standing)]
        )
        # In the air no foot stands; else all four do, for the support polygon
        table.at_most("ground.feet", [*standing, (c.box[LEAPS, k], 1), (c.drives[m, k], -1)], 1.0)
        feet: list[Term] = [(column, -v) for column, v in standing]
        table.at_most("ground.feet", [(c.leg[m, k], 1), (c.box[LEAPS, k], -1), *feet])
    for w in range(W):
        table.at_most("logic.anchors", [(c.wall[w, m, k], 1) for m in modules], 1.0)


def _add_continuity(problem: ConsensusProblem, table: LinearRows, c: VariableColumns) -> None:
    """Add the continuity of contacts: latches to terrain, modules and as legs stay to the end.

    Arms latch to the box together and release it together, and a quadruped leaps at most once: the
    refinement can execute just these.
    """
    for k in range(problem.intervals):
        for current, is_ever_held in zip(
            c.hold[..., k].ravel(), c.is_ever_held.ravel(), strict=True
        ):
            table.at_most("latch.stays", [(current, 1), (is_ever_held, -1)])
    for k in range(problem.intervals - 1):
        table.at_most("box.once", [(c.box[STABLE, k + 1], 1), (c.box[STABLE, k], -1)])
        table.at_most("box.once", [(c.box[FREE, k], 1), (c.box[FREE, k + 1], -1)])
        for numbers in (c.wall, c.carry, c.mount):
            for current, following in zip(
                numbers[..., k].ravel(), numbers[..., k + 1].ravel(), strict=True
            ):
                table.at_most("latch.stays", [(current, 1), (following, -1)])
        for current, following in zip(
            c.hold[..., k].ravel(), c.hold[..., k + 1].ravel(), strict=True
        ):
            table.at_most(
                "latch.stays", [(current, 1), (following, -1), (c.box[HELD, k + 1], 1)], 1.0
            )
            table.at_most("latch.stays", [(following, 1), (current, -1), (c.box[HELD, k], 1)], 1.0)
        leaps: list[Term] = [(c.box[LEAPS, k + 1], 1), (c.box[LEAPS, k], -1)]
        table.at_most("box.one_leap", [*leaps, (c.takes_off[k], -1)])
    table.at_most("box.one_leap", [(column, 1) for column in c.takes_off], 1.0)
