"""Rows for the box: its dynamics in each mode, forces, friction, and where its centre may be."""

from __future__ import annotations

from climbplan.limms.consensus.columns import FASTEST, Columns
from climbplan.limms.consensus.setting import FREE, HELD, LEAPS, STANDS, Setting
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.program.linear_rows import LinearRows, Term

FORCE_SHARE = 0.95  # of limits, which are balls: rows are planes round them
CONE_SHARE = 0.9
_DIAGONALS = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))


def add_box(setting: Setting, table: LinearRows, columns: Columns) -> None:
    """Eqs. (6.5) to (6.8) with the latch moment that (6.6) leaves out, and the box's free space.

    Accelerations are constant in an interval. Velocities are split over the modes, so that the
    lengths of intervals, which depend on the mode, keep the rows linear and tight.
    """
    scene = setting.scene
    for axis in range(3):
        table.bound(columns.position[0, axis], scene.box_start[0, axis], scene.box_start[0, axis])
        table.bound(columns.velocity[0, axis], 0.0, 0.0)
        speed = scene.arrival_speed / 3**0.5
        table.bound(columns.velocity[-1, axis], -speed, speed)
        end, missed = columns.position[-1, axis], columns.missed[axis]
        table.row("goal.reached", [(missed, 1), (end, -1)], -scene.goal[axis], float("inf"))
        table.row("goal.reached", [(missed, 1), (end, 1)], scene.goal[axis], float("inf"))
    for k in range(setting.intervals):
        _dynamics(setting, table, columns, k)
        _arm_forces(setting, table, columns, k)
        _foot_forces(setting, table, columns, k)
        for axis in range(3):
            for knot in (k, k + 1):
                place = columns.position[knot, axis]
                lows: list[Term] = [
                    (b, -setting.centres[i, 0, axis]) for i, b in enumerate(columns.centre[:, k])
                ]
                highs: list[Term] = [
                    (b, -setting.centres[i, 1, axis]) for i, b in enumerate(columns.centre[:, k])
                ]
                if len(lows):
                    table.row("clear.box", [(place, 1), *lows], 0.0, float("inf"))
                    table.at_most("clear.box", [(place, 1), *highs])
        if len(columns.centre):
            table.equal("clear.box", [(b, 1.0) for b in columns.centre[:, k]], 1.0)


def _dynamics(setting: Setting, table: LinearRows, c: Columns, k: int) -> None:
    mass = float(setting.scene.box_mass[0])
    seconds = setting.form.seconds
    in_air, h_air = (c.box[FREE, k], c.box[LEAPS, k]), seconds[FREE]
    h_held, h_stands = seconds[HELD], seconds[STANDS]
    for axis in range(3):
        fall = GRAVITY if axis == 2 else 0.0
        air, held, stands = c.in_mode[:, k, axis]
        a_held, a_stands = c.pull[:, k, axis]
        here, after = c.position[k, axis], c.position[k + 1, axis]
        v, v_after = c.velocity[k, axis], c.velocity[k + 1, axis]
        table.equal("box.motion", [(v, 1), (air, -1), (held, -1), (stands, -1)])
        for part, modes in (
            (air, in_air),
            (held, (c.box[HELD, k],)),
            (stands, (c.box[STANDS, k],)),
        ):
            opened: list[Term] = [(column, 1.0) for column in modes]
            table.within("box.motion", [(part, 1)], 0.0, opened, FASTEST)
        table.equal(
            "box.motion",
            [
                (v_after, 1),
                (v, -1),
                (a_held, -h_held),
                (a_stands, -h_stands),
                *((column, fall * h_air) for column in in_air),
            ],
        )
        table.equal(
            "box.motion",
            [
                (after, 1),
                (here, -1),
                (air, -h_air),
                (held, -h_held),
                (stands, -h_stands),
                (a_held, -(h_held**2) / 2),
                (a_stands, -(h_stands**2) / 2),
                *((column, fall * h_air**2 / 2) for column in in_air),
            ],
        )
        for pull, effort in zip(c.pull[:, k, axis], c.effort[:, k, axis], strict=True):
            table.at_most("cost.effort", [(pull, 1), (effort, -1)])
            table.at_most("cost.effort", [(pull, -1), (effort, -1)])
        arms: list[Term] = [(column, -1) for column in c.force[:, k, axis]]
        table.equal("box.dynamics", [(a_held, mass), *arms, (c.box[HELD, k], mass * fall)])
        feet: list[Term] = [(column, -1) for column in c.push[:, k, axis]]
        table.equal("box.dynamics", [(a_stands, mass), *feet, (c.box[STANDS, k], mass * fall)])


def _arm_forces(setting: Setting, table: LinearRows, c: Columns, k: int) -> None:
    scene = setting.scene
    most, moment = FORCE_SHARE * scene.module.max_force, FORCE_SHARE * scene.module.latch_moment
    for side in range(4):
        holds: list[Term] = [(column, 1.0) for column in c.hold[side, :, k]]
        for name, columns, limit in (
            ("force.limit", c.force[side, k], most),
            ("latch.moment", c.moment[side, k], moment),
        ):
            for column in columns:
                table.within(name, [(column, 1)], 0.0, holds, limit)
            for signs in _DIAGONALS:
                terms: list[Term] = list(zip(columns, map(float, signs), strict=True))
                table.within(name, terms, 0.0, holds, 3**0.5 * limit)
    # Forces and latch moments leave no moment about the centre
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        terms = [(column, 1.0) for column in c.moment[:, k, axis]]
        for side in range(4):
            offset = scene.side_offset(0, side)
            terms += [(c.force[side, k, two], offset[one]), (c.force[side, k, one], -offset[two])]
        table.equal("latch.moment", terms)


def _foot_forces(setting: Setting, table: LinearRows, c: Columns, k: int) -> None:
    scene = setting.scene
    most, cone = FORCE_SHARE * scene.module.max_force, CONE_SHARE * scene.friction / 2**0.5
    for m in range(scene.count):
        up = c.push[m, k, 2]
        table.bound(up, 0.0, most)
        for column in c.push[m, k, :2]:
            table.at_most("force.friction", [(column, 1), (up, -cone)])
            table.at_most("force.friction", [(column, -1), (up, -cone)])
        table.at_most("force.limit", [(up, 1), (c.leg[m, k], -most)])
        table.at_most("force.unattached", [(up, 1), (c.box[STANDS, k], -most)])
        table.at_most(
            "force.unattached", [(up, 1), *((column, -most) for column in c.ground[:, m, k])]
        )
