"""Linear rows for the box: dynamics in each mode, forces, friction, and its free space.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from climbplan.limms.consensus.problem import FREE, HELD, LEAPS, STANDS, ConsensusProblem
from climbplan.limms.consensus.variables import MAX_BOX_SPEED, VariableColumns
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.program.linear_rows import LinearRows, Term

FORCE_FRACTION = 0.95  # of the limits: rows are planes around balls
CONE_FRACTION = 0.9
_DIAGONALS = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))


def add_box_rows(problem: ConsensusProblem, table: LinearRows, columns: VariableColumns) -> None:
    """Add the rows of eqs. (6.5) to (6.8) with latch moments, and of the box's free space.

    Eq. (6.6) neglects the latch moment, which is included here. Accelerations are constant in an
    interval. Velocities are split over the modes (a convex-hull formulation), so that rows stay
    linear and tight although the length of an interval depends on its mode.
    """
    scene = problem.scene
    for axis in range(3):
        table.bound(columns.position[0, axis], scene.box_start[0, axis], scene.box_start[0, axis])
        table.bound(columns.velocity[0, axis], 0.0, 0.0)
        speed = scene.arrival_speed / 3**0.5
        table.bound(columns.velocity[-1, axis], -speed, speed)
        final, goal_error = columns.position[-1, axis], columns.goal_error[axis]
        table.row("goal.position", [(goal_error, 1), (final, -1)], -scene.goal[axis], float("inf"))
        table.row("goal.position", [(goal_error, 1), (final, 1)], scene.goal[axis], float("inf"))
    for k in range(problem.intervals):
        _add_dynamics(problem, table, columns, k)
        _add_arm_forces(problem, table, columns, k)
        _add_foot_forces(problem, table, columns, k)
        for axis in range(3):
            for knot in (k, k + 1):
                position = columns.position[knot, axis]
                lows: list[Term] = [
                    (b, -problem.centre_blocks[i, 0, axis])
                    for i, b in enumerate(columns.centre[:, k])
                ]
                highs: list[Term] = [
                    (b, -problem.centre_blocks[i, 1, axis])
                    for i, b in enumerate(columns.centre[:, k])
                ]
                if len(lows):
                    table.row("box.collision", [(position, 1), *lows], 0.0, float("inf"))
                    table.at_most("box.collision", [(position, 1), *highs])
        if len(columns.centre):
            table.equal("box.collision", [(b, 1.0) for b in columns.centre[:, k]], 1.0)


def _add_dynamics(problem: ConsensusProblem, table: LinearRows, c: VariableColumns, k: int) -> None:
    """Add the discrete dynamics of the box in one interval, a sum over its modes."""
    mass = float(problem.scene.box_mass[0])
    seconds = problem.formulation.interval_seconds
    in_air, h_air = (c.box[FREE, k], c.box[LEAPS, k]), seconds[FREE]
    h_held, h_stands = seconds[HELD], seconds[STANDS]
    for axis in range(3):
        gravity = GRAVITY if axis == 2 else 0.0
        v_air, v_held, v_stands = c.in_mode[:, k, axis]
        a_held, a_stands = c.acceleration[:, k, axis]
        position, next_position = c.position[k, axis], c.position[k + 1, axis]
        v, v_after = c.velocity[k, axis], c.velocity[k + 1, axis]
        table.equal("box.kinematics", [(v, 1), (v_air, -1), (v_held, -1), (v_stands, -1)])
        for mode_velocity, modes in (
            (v_air, in_air),
            (v_held, (c.box[HELD, k],)),
            (v_stands, (c.box[STANDS, k],)),
        ):
            is_active: list[Term] = [(column, 1.0) for column in modes]
            table.within("box.kinematics", [(mode_velocity, 1)], 0.0, is_active, MAX_BOX_SPEED)
        table.equal(
            "box.kinematics",
            [
                (v_after, 1),
                (v, -1),
                (a_held, -h_held),
                (a_stands, -h_stands),
                *((column, gravity * h_air) for column in in_air),
            ],
        )
        table.equal(
            "box.kinematics",
            [
                (next_position, 1),
                (position, -1),
                (v_air, -h_air),
                (v_held, -h_held),
                (v_stands, -h_stands),
                (a_held, -(h_held**2) / 2),
                (a_stands, -(h_stands**2) / 2),
                *((column, gravity * h_air**2 / 2) for column in in_air),
            ],
        )
        for acceleration, abs_acceleration in zip(
            c.acceleration[:, k, axis], c.abs_acceleration[:, k, axis], strict=True
        ):
            table.at_most("cost.effort", [(acceleration, 1), (abs_acceleration, -1)])
            table.at_most("cost.effort", [(acceleration, -1), (abs_acceleration, -1)])
        arms: list[Term] = [(column, -1) for column in c.force[:, k, axis]]
        table.equal("box.dynamics", [(a_held, mass), *arms, (c.box[HELD, k], mass * gravity)])
        feet: list[Term] = [(column, -1) for column in c.foot_force[:, k, axis]]
        table.equal("box.dynamics", [(a_stands, mass), *feet, (c.box[STANDS, k], mass * gravity)])


def _add_arm_forces(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, k: int
) -> None:
    """Add force and moment limits of arms at all sides in one interval, and the moment balance."""
    scene = problem.scene
    max_force, max_moment = (
        FORCE_FRACTION * scene.module.max_force,
        FORCE_FRACTION * scene.module.latch_moment,
    )
    for side in range(4):
        is_held: list[Term] = [(column, 1.0) for column in c.hold[side, :, k]]
        for name, columns, limit in (
            ("force.limit", c.force[side, k], max_force),
            ("latch.moment", c.moment[side, k], max_moment),
        ):
            for column in columns:
                table.within(name, [(column, 1)], 0.0, is_held, limit)
            for signs in _DIAGONALS:
                terms: list[Term] = list(zip(columns, map(float, signs), strict=True))
                table.within(name, terms, 0.0, is_held, 3**0.5 * limit)
    # Forces and latch moments balance about the centre
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        terms = [(column, 1.0) for column in c.moment[:, k, axis]]
        for side in range(4):
            offset = scene.side_offset(0, side)
            terms += [(c.force[side, k, v], offset[u]), (c.force[side, k, u], -offset[v])]
        table.equal("latch.moment", terms)


def _add_foot_forces(
    problem: ConsensusProblem, table: LinearRows, c: VariableColumns, k: int
) -> None:
    """Add limits, friction and contact of foot forces in one interval."""
    scene = problem.scene
    max_force, cone = (
        FORCE_FRACTION * scene.module.max_force,
        CONE_FRACTION * scene.friction / 2**0.5,
    )
    for m in range(scene.num_modules):
        normal_force = c.foot_force[m, k, 2]
        table.bound(normal_force, 0.0, max_force)
        for column in c.foot_force[m, k, :2]:
            table.at_most("force.friction", [(column, 1), (normal_force, -cone)])
            table.at_most("force.friction", [(column, -1), (normal_force, -cone)])
        table.at_most("force.limit", [(normal_force, 1), (c.leg[m, k], -max_force)])
        table.at_most("force.without_contact", [(normal_force, 1), (c.box[STANDS, k], -max_force)])
        table.at_most(
            "force.without_contact",
            [(normal_force, 1), *((column, -max_force) for column in c.ground[:, m, k])],
        )
