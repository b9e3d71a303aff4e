"""Walks of a robot from a URDF: torques of standing legs in plans, files and checks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker
from walking_urdf import planned_walk, walking_robot

from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.urdf.walking_body import build_walking_body
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.check.speed import compute_leg_speeds
from climbplan.walking.check.torque import compute_leg_loads
from climbplan.walking.check.verification import verify
from climbplan.walking.kernels.joint_torque_rows import solve_leg_jacobian
from climbplan.walking.kernels.parameters import LegChain
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram
from climbplan.walking.offline.sqp import solve_gait
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.walk_plan import WalkPlan

pytest.importorskip("pinocchio")


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> WalkPlan:
    return planned_walk(tmp_path_factory.mktemp("walker"))


def test_the_plan_holds_anywhere(planned: WalkPlan, tmp_path: Path) -> None:
    """Its file carries robot and URDF: it is verified where there is neither."""
    path = tmp_path / "plan.h5"
    write_walk_plan(planned, path)
    found = verify(path)
    assert [check.name for check in found.checks if not check.passed] == []
    names = [check.name for check in found.checks]
    assert "torque.limit" in names
    assert "stance.reach" in names
    stored = read_walk_plan(path)
    assert stored.robot_urdf == planned.robot_urdf
    assert stored.task.legs is not None


def test_another_motor_in_the_file_is_told(planned: WalkPlan, tmp_path: Path) -> None:
    legs = planned.task.legs
    assert legs is not None
    task = replace(planned.task, legs=replace(legs, max_torque=1.01 * legs.max_torque))
    write_walk_plan(replace(planned, task=task), tmp_path / "plan.h5")
    failed = {c.name: c.worst_at for c in verify(tmp_path / "plan.h5").checks if not c.passed}
    assert failed == {"file.spec_values": "legs.max_torque"}


def test_torques_are_the_work_of_forces(planned: WalkPlan) -> None:
    """By differences of toes: what a joint's turn moves the toe against the force."""
    legs, found = planned.task.legs, planned.trajectory
    assert legs is not None
    loads = compute_leg_loads(legs, planned.task, found)
    begun = found.state[1]
    rotation = rotation_world_body(begun[6:9])
    spots = (found.toes[1] - begun[:3]) @ rotation
    angles = legs.chain.inverse(spots, legs.lower, legs.upper).best()
    for leg in np.flatnonzero(found.gait.contact[1]):
        for joint in range(3):
            more, less = angles.copy(), angles.copy()
            more[leg, joint] += 1e-6
            less[leg, joint] -= 1e-6
            moved = legs.chain.joint_points(more)[leg, -1] - legs.chain.joint_points(less)[leg, -1]
            work = found.force[1, leg] @ (rotation @ moved) / 2e-6
            assert loads.torque[1, 0, leg, joint] == pytest.approx(work, abs=1e-5)


@pytest.mark.parametrize("joints", [3, 4, 6])
def test_compiled_jacobians_are_those_of_the_chain(tmp_path: Path, joints: int) -> None:
    """Of legs with freedom to choose at the angles nearest to their posture, as anywhere."""
    found = build_walking_body(walking_robot(tmp_path, Walker(joints=joints)))
    legs, boxes = found.legs, found.boxes
    drawn = boxes.center + np.random.default_rng(3).uniform(-1, 1, (50, 4, 3)) * boxes.half
    solution = legs.chain.inverse(drawn, legs.lower, legs.upper)
    wanted = legs.chain.jacobian(solution.best())
    own, chain = np.empty((3, joints)), legs.chain
    for spots, expected in zip(drawn, wanted, strict=True):
        for leg in range(4):
            links = LegChain(
                chain.joint_zero[leg], chain.axis_zero[leg], chain.slides_zero[leg],
                chain.drives[leg], chain.toe_zero[leg], chain.posture[leg],
            )  # fmt: skip
            assert solve_leg_jacobian(links, spots[leg], own)
            # Where legs may choose, the chain stops a little before it is nearest
            off = 1e-7 if joints == 3 else 1e-3
            np.testing.assert_allclose(own, expected[leg], rtol=0, atol=off)


def test_plans_keep_torque_limits_and_the_check_sees_what_does_not(planned: WalkPlan) -> None:
    task, found = planned.task, planned.trajectory
    assert task.legs is not None
    asked = np.abs(compute_leg_loads(task.legs, task, found).torque).max()
    weak = replace(task.legs, max_torque=np.full((4, 3), 0.93 * asked))
    weaker = replace(task, legs=weak)
    assert format_failures(check_trajectory(weaker, found)).startswith("torque.limit")
    again = solve_gait(weaker, found.gait, iterations=80)
    assert again.trajectory is not None
    assert format_failures(check_trajectory(weaker, again.trajectory)) == ""
    used = np.abs(compute_leg_loads(weak, weaker, again.trajectory).torque).max()
    assert used == pytest.approx(0.93 * asked, rel=2e-3)  # they bind


def test_joints_that_are_too_fast_are_told_by_rows_and_check(planned: WalkPlan) -> None:
    task, found = planned.task, planned.trajectory
    assert task.legs is not None
    program = FixedContactProgram(task, found.gait)
    spots = found.toes[program.footing.first, program.footing.leg, :2]
    most = (compute_leg_speeds(task.legs, task, found).speed / task.legs.max_speed).max()
    slow = replace(task, legs=replace(task.legs, max_speed=most * task.legs.max_speed))
    told = FixedContactProgram(slow, found.gait).joints.compute_speed_excess(
        found.state, found.toes, spots, program.tilt
    )
    assert told == pytest.approx(0.0, abs=0.05)


def test_where_all_joints_are_too_slow_a_motion_says_by_how_much(planned: WalkPlan) -> None:
    """What has no motion at all gives a search nothing to go on from."""
    task, gait = planned.task, planned.trajectory.gait
    assert task.legs is not None
    slow = replace(task, legs=replace(task.legs, max_speed=0.3 * task.legs.max_speed))
    assert solve_gait(slow, gait, elastic=False).trajectory is None
    found = solve_gait(slow, gait)
    assert found.trajectory is not None
    assert found.reach_violation > 1e-3
    assert not found.is_feasible
