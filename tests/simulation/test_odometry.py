"""The body's pose by the joints' own sensors, and a regulator that knows no more than that."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.control.regulator import JointOdometry
from climbplan.climb.simulation.replay import simulate
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions, Regulated

Planned = Callable[..., ClimbPlan]


def test_planned_angles_tell_the_planned_pose(planned: Planned) -> None:
    plan = planned()
    odometry, moving = JointOdometry(plan), plan.trajectory
    angles = compute_true_angles(plan, sample_instants(plan))
    for sample in range(len(moving.time)):
        com, rotation = odometry.pose(sample, angles[sample])
        assert np.abs(com - moving.com[sample]).max() < 1e-3
    assert np.abs(rotation - rotation_world_body(moving.rpy[-1])).max() < 2e-3


def test_a_body_that_sank_is_seen_to_have_sunk(planned: Planned) -> None:
    plan = planned()
    com, rpy = plan.rounds.com[0] + [0.0, 0.01, -0.02], plan.rounds.rpy[0]
    angles = solve_inverse_kinematics(plan.robot, to_body(com, rpy, plan.rounds.toes[0])).best()
    seen, _ = JointOdometry(plan).pose(0, angles)
    np.testing.assert_allclose(seen, com, atol=1e-9)


def test_regulator_by_joints_keeps_the_place_that_soft_motors_lose(planned: Planned) -> None:
    plan = planned()
    off = {}
    regulators: tuple[Regulated, ...] = ("nothing", "joints")
    for what in regulators:
        run = simulate(plan, Conditions(gain=0.9, regulator=what))
        assert not run.fallen
        off[what] = float(np.linalg.norm(run.com[-1] - plan.trajectory.com[-1]))
    assert off["nothing"] > 0.005
    assert off["joints"] < 0.4 * off["nothing"]
    assert off["joints"] == pytest.approx(0.0, abs=0.004)
