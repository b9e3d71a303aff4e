"""The playable motion: its samples meet every instant, whatever the rate and speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.motion.trajectory import MAX_ACCELERATION, plan_trajectory
from climbplan.climb.plan.climb_plan import Trajectory
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import UsageError
from climbplan.instances.straight_climb import interpolate_rounds
from climbplan.robots.kinematics import toe_world

SceneMaker = Callable[..., ClimbScene]


def motion(scene: ClimbScene) -> tuple[Trajectory, float]:
    """The motion, and by how much its samples miss the worst instant [m]."""
    rounds = interpolate_rounds(scene)
    instants = plan_instants(scene, rounds)
    forces = plan_forces(scene, instants)
    trajectory = plan_trajectory(scene, rounds, instants, forces)
    toes = toe_world(scene.robot, trajectory.com, trajectory.rpy, trajectory.joint_command)
    worst = 0.0
    for k in range(instants.count):
        off = np.linalg.norm(toes - forces.toe_command[k], axis=-1)
        off = np.where(instants.contact[k], off, 0.0).max(axis=1)
        off = np.maximum(off, np.linalg.norm(trajectory.com - instants.com[k], axis=-1))
        worst = max(worst, float(off.min()))
    return trajectory, worst


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"trajectory.rate": 1.0},  # slower than a limb step's phases
        {"trajectory.rate": 0.1},
        {"trajectory.speed": 1.0},  # as fast as the joints allow
        {"task.goal.com": (0.0, 0.0, 0.0), "task.goal.toes": {}},  # nothing but steps on the spot
    ],
    ids=str,
)
def test_samples_meet_every_instant(demo_climb: SceneMaker, values: dict[str, Any]) -> None:
    trajectory, miss = motion(demo_climb(**values))
    assert miss < 1e-9
    rate = values.get("trajectory.rate", 20.0)
    np.testing.assert_allclose(np.diff(trajectory.time) * rate, 1.0)


def test_speed_is_the_one_asked_for(demo_climb: SceneMaker) -> None:
    trajectory, _ = motion(demo_climb(**{"trajectory.speed": 0.005}))
    assert trajectory.time[-1] == pytest.approx(0.3 / 0.005, rel=0.01)


def test_bodies_in_a_hurry_speed_up_by_little(demo_climb: SceneMaker) -> None:
    scene = demo_climb(**{"trajectory.speed": 1.0, "trajectory.rate": 100.0})
    trajectory, _ = motion(scene)
    least = np.diff(trajectory.com, 2, axis=0) * 100.0**2
    fastest = np.linalg.norm(least, axis=1).max() / scene.robot.gravity
    assert 0.5 * MAX_ACCELERATION < fastest < 1.05 * MAX_ACCELERATION


def test_endless_motions_are_refused(demo_climb: SceneMaker) -> None:
    with pytest.raises(UsageError, match=r"samples at 20 Hz.*raise trajectory.speed"):
        motion(demo_climb(**{"trajectory.speed": 1e-9}))
