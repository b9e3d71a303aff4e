"""The mixed-integer block's rows: each logic rule can be kept, and not be broken; names of all."""

from __future__ import annotations

from dataclasses import replace

import highspy
import numpy as np
import pytest
from limms_scenes import scene

from climbplan.limms.check.limits import LIMITS
from climbplan.limms.consensus.logic_rows import add_logic_rows
from climbplan.limms.consensus.mixed_integer import GOAL_TOLERANCE, MixedIntegerBlock
from climbplan.limms.consensus.problem import FREE, HELD, LEAPS, STABLE, STANDS, build_problem
from climbplan.limms.consensus.variables import VariableColumns, add_variables
from climbplan.program.linear_rows import LinearRows
from climbplan.solvers.highs.model import build_rows_model, create_highs

K = 3  # intervals


@pytest.fixture(scope="module")
def rules() -> tuple[LinearRows, VariableColumns]:
    four = build_problem(scene("limms_lift_light", "box.arrival_speed=1"), K)
    table = LinearRows()
    columns = add_variables(four, table)
    add_logic_rows(four, table, columns)
    return table, columns


def allowed(rules: tuple[LinearRows, VariableColumns], ones: list[int], zeros: list[int]) -> bool:
    """Whether some choice has these columns at 1 and those at 0."""
    table, _ = rules
    lower, upper = np.array(table.lower), np.array(table.upper)
    lower[ones], upper[zeros] = 1.0, 0.0
    if (lower > upper).any():
        return False
    model = build_rows_model(table)
    model.col_lower_, model.col_upper_ = lower, upper
    solver = create_highs()
    solver.passModel(model)
    solver.run()
    return bool(solver.getModelStatus() == highspy.HighsModelStatus.kOptimal)


def owner(rules: tuple[LinearRows, VariableColumns], numbers: np.ndarray, place: int) -> int:
    """The module that an anchor, or a side as a leg's, is left to."""
    table, _ = rules
    upper = np.array(table.upper)
    return int(np.flatnonzero(upper[numbers[place, :, -1]])[0])


def test_every_behaviour_is_possible(rules: tuple[LinearRows, VariableColumns]) -> None:
    _, c = rules
    for mode in (STABLE, FREE, HELD, STANDS, LEAPS):
        assert allowed(rules, [c.box[mode, -1]], []), mode
    for numbers in (c.drives, c.arm, c.added, c.leg):
        assert any(allowed(rules, [numbers[m, -1]], []) for m in range(4))


def test_rules_of_legs(rules: tuple[LinearRows, VariableColumns]) -> None:
    _, c = rules
    k = K - 1
    m = owner(rules, c.mount, 0)
    for box in (c.box[STANDS, k], c.box[LEAPS, k]):
        assert not allowed(rules, [box], list(c.mount[0, :, k]))  # 1
    assert not allowed(rules, [c.mount[0, m, k]], [c.box[STANDS, k], c.box[LEAPS, k]])  # 2
    assert not allowed(rules, [c.mount[0, m, k]], [c.leg[m, k]])  # 3
    assert not allowed(rules, [c.leg[m, k]], list(c.mount[:, m, k]))  # 4
    assert allowed(rules, [c.mount[0, m, k], c.box[STANDS, k], c.leg[m, k]], [])


def test_rules_of_arms(rules: tuple[LinearRows, VariableColumns]) -> None:
    _, c = rules
    k = K - 1
    m = owner(rules, c.wall, 0)
    assert not allowed(rules, [c.box[HELD, k]], list(c.hold[..., k].ravel()))  # 5
    assert not allowed(rules, [c.hold[2, m, k]], [c.arm[m, k], c.added[m, k]])  # 6
    assert not allowed(rules, [c.arm[m, k]], list(c.wall[:, m, k]))  # 7
    assert not allowed(rules, [c.wall[0, m, k]], [c.arm[m, k]])  # 8
    for box in (STABLE, FREE):
        assert not allowed(rules, [c.box[box, k], c.hold[2, m, k]], [])  # 12
    assert allowed(rules, [c.box[HELD, k], c.hold[2, m, k], c.wall[0, m, k]], [])


def test_rules_of_added_arms(rules: tuple[LinearRows, VariableColumns]) -> None:
    _, c = rules
    k = K - 1
    parent = owner(rules, c.wall, 0)
    child, other = [m for m in range(4) if m != parent][:2]
    assert not allowed(rules, [c.added[child, k]], list(c.carry[:, child, k]))  # 9
    assert not allowed(rules, [c.carry[parent, child, k]], [c.added[child, k]])  # 10
    assert not allowed(rules, [c.carry[parent, child, k]], [c.arm[parent, k]])
    assert not allowed(rules, [c.carry[parent, child, k], c.carry[parent, other, k]], [])
    assert not allowed(rules, [c.carry[parent, child, k], c.hold[2, parent, k]], [])  # 11
    assert allowed(rules, [c.carry[parent, child, k], c.hold[2, child, k]], [])


def test_one_mode_one_hand_one_pick_up(rules: tuple[LinearRows, VariableColumns]) -> None:
    _, c = rules
    m = owner(rules, c.wall, 0)
    assert not allowed(rules, [c.arm[m, 1], c.leg[m, 1]], [])
    assert not allowed(rules, [c.hold[2, 0, 1], c.hold[2, 1, 1]], [])
    assert not allowed(rules, [c.hold[2, m, 1], c.hold[3, m, 1]], [])
    assert not allowed(rules, [c.box[HELD, 1], c.box[STABLE, 2]], [])
    assert not allowed(rules, [c.box[HELD, 1], c.box[STANDS, 2]], [])
    assert not allowed(rules, [c.wall[0, m, 1]], [c.wall[0, m, 2]])


OWN = {  # what the block alone states: no sample of a plan has two modes, leaps back or consents
    *("logic.box_mode", "logic.behaviour", "logic.module_mode", "latch.stays", "box.once"),
    *("box.one_leap", "ground.feet", "cost.effort", "consensus"),
}


@pytest.mark.parametrize("name", ["limms_lift_light", "limms_throw", "limms_jump", "limms_walk"])
def test_blocks_have_the_names_of_the_checks(name: str) -> None:
    block = MixedIntegerBlock(build_problem(scene(name), 4))
    names = set(block.rows.names.names)
    assert names - OWN <= set(LIMITS)
    assert {"box.dynamics", "latch.moment", "force.limit", "speed.limit"} <= names


def test_a_spoiled_answer_is_off_in_the_block_that_was_spoiled() -> None:
    block = MixedIntegerBlock(build_problem(scene("limms_throw"), 8))
    block.fix_behaviour("arms")
    found = block.find_feasible(30.0)
    assert found.x is not None
    assert found.worst_rows is not None
    assert found.worst_rows.residual < 1e-5
    c = block.columns
    k = int(np.flatnonzero(np.round(found.x[c.box[HELD]]))[0])  # the box is held
    for columns, name in (
        (c.in_mode[0, k], "box.kinematics"),
        (c.hold[:, :, k].ravel(), "logic.rule_5"),
        (c.goal_error, "goal.position"),
    ):
        x = found.x.copy()
        x[columns] = 0.0 if name == "logic.rule_5" else x[columns] - 0.5
        off = {each.name for each in block.rows.residuals(x) if each.residual > 0.01}
        assert name in off
        assert "kinematics.forward" not in off


def test_a_block_is_loosened_and_holds_again() -> None:
    stiff = scene("limms_throw")
    bent = tuple(0.2 * angle for angle in stiff.module.joint_range)
    module = stiff.module.model_copy(update={"joint_range": bent})
    block = MixedIntegerBlock(build_problem(replace(stiff, module=module), 6))
    block.fix_behaviour("arms")
    assert block.find_feasible(20.0).status == "infeasible"
    block.relax_rows("kinematics.joint_bounds")
    assert block.find_feasible(20.0).goal_error <= GOAL_TOLERANCE
    block.restore_rows("kinematics.joint_bounds")
    again = block.find_feasible(20.0)
    assert again.status == "infeasible"
    assert GOAL_TOLERANCE < again.goal_error < np.inf  # of the best plan seen
