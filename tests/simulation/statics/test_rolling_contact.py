"""Spherical feet of the quasi-static engine: where they touch, and how they roll on."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.implicit_dynamics.engine import (
    PreparedMotion,
    prepare_steps,
    simulate_steps,
)
from climbplan.climb.simulation.implicit_dynamics.outcome import HAS_FALLEN, MAX_DEVIATION, MAX_SLIP
from climbplan.robots.kinematics import toe_world
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import Conditions

SPECS = Path(__file__).parents[3] / "specs"
RADIUS = 0.03
ONE_ROUND = ["task.rounds=1", "task.goal.com=[0, 0, 0.12]", "terrain.walls.gap=1.29"]


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    folder = tmp_path_factory.mktemp("feet")
    for name in ("climb_walker.yaml", "robot_walker.yaml", "walker.urdf"):
        shutil.copy(SPECS / name, folder)
    robot = folder / "robot_walker.yaml"
    robot.write_text(f"{robot.read_text()}\nfoot: {{radius: {RADIUS}}}\n")
    return plan_climb(load_climb(folder / "climb_walker.yaml", ONE_ROUND))


@pytest.fixture(scope="module")
def steps(plan: ClimbPlan) -> PreparedMotion:
    return prepare_steps(plan, Conditions())


def test_limbs_end_where_their_feet_touch_their_walls(
    plan: ClimbPlan, steps: PreparedMotion
) -> None:
    """The end at zero angles is its foot's radius from the centre, towards the wall when placed."""
    zero = steps.motion.zero_pose[:, 2 * plan.robot.joint_count]
    off = np.linalg.norm(steps.motion.contact_points - zero, axis=-1)
    np.testing.assert_allclose(off, RADIUS, atol=1e-12)
    chain = plan.robot.mechanism
    assert isinstance(chain, SerialChain)
    ended = replace(plan.robot, mechanism=replace(chain, toe_zero=steps.motion.contact_points[0]))
    start = plan.rounds.com[:1], plan.rounds.rpy[:1], plan.instants.joint_angles[:1]
    touching = toe_world(ended, *start)[0] - toe_world(plan.robot, *start)[0]
    stays = plan.instants.contact[0]
    arm = -RADIUS * plan.instants.normal[0]
    np.testing.assert_allclose(touching[stays], arm[stays], atol=2e-4)
    path = np.zeros((len(steps.sample), 3 + 6 * plan.robot.limb_count))
    row = simulate_steps(plan, steps, Conditions(), path)
    assert row[HAS_FALLEN] == 0
    toes = path[:, 3 : 3 + 3 * plan.robot.limb_count].reshape(len(path), -1, 3)
    stands = steps.motion.should_press.astype(bool)
    np.testing.assert_allclose(np.abs(toes[..., 0][stands]), 1.29 / 2, atol=1e-9)


def test_a_foot_rolls_as_the_link_turns_and_slides_nowhere(
    plan: ClimbPlan, steps: PreparedMotion
) -> None:
    path = np.zeros((len(steps.sample), 3 + 6 * plan.robot.limb_count))
    row = simulate_steps(plan, steps, Conditions(), path)
    assert row[MAX_DEVIATION] < 3e-3
    assert row[MAX_SLIP] < 1e-3
    # Another run is given the same limbs, whatever the one before left behind
    assert (simulate_steps(plan, steps, Conditions()) == row).all()
    toes = path[:, 3 : 3 + 3 * plan.robot.limb_count].reshape(len(path), -1, 3)
    planned = plan.trajectory
    centres = toe_world(
        plan.robot, planned.com[:1], planned.rpy[:1], plan.instants.joint_angles[:1]
    )[0]
    moved = np.linalg.norm(toes[-1] - toes[0], axis=-1)
    assert moved.max() > 0.5 * np.linalg.norm(plan.rounds.toes[-1] - centres, axis=-1).max()
