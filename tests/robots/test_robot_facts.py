"""What `climbplan robot` says, against statics written down anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from climbplan.robots.facts import measure_robot
from climbplan.robots.kinematics import toe_body
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import list_builtin_robots, load_robot


@pytest.mark.parametrize("name", list_builtin_robots())
def test_standing_balances_the_weight(name: str) -> None:
    robot = Robot.from_spec(load_robot(name))
    facts = measure_robot(robot)
    assert toe_body(robot, facts.stance_angles) == pytest.approx(robot.stance_body, abs=1e-9)
    assert facts.standing_force is not None
    assert facts.standing_torque is not None
    assert facts.standing_force.sum() == pytest.approx(robot.weight, rel=1e-3)
    assert (facts.standing_force >= 0).all()
    # By virtual work: a joint that turns lifts its toe by dz
    for joint in range(robot.joint_count):
        turned = facts.stance_angles.copy()
        turned[:, joint] += 1e-6
        lift = (toe_body(robot, turned) - robot.stance_body)[:, 2] / 1e-6
        expected = lift * facts.standing_force
        assert facts.standing_torque[:, joint] == pytest.approx(expected, abs=1e-3)
    assert facts.standing_safety is not None
    assert (facts.reach > 0.2).all()
    assert np.array_equal(facts.samples, measure_robot(robot).samples)


def test_a_body_beside_its_toes_tips_over() -> None:
    robot = Robot.from_spec(load_robot("silvia"))
    aside = replace(robot, stance_body=np.abs(robot.stance_body) * [1, 1, -1] + [0.0, 0.05, 0.0])
    facts = measure_robot(aside)
    assert facts.standing_force is None
    assert facts.standing_safety is None
