"""How fast a motion may be played: forces exist up to the pace that is found, and not beyond."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import climbplan
from climbplan.cli.app import run
from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.errors import UsageError
from climbplan.motions.completion import read_robot
from climbplan.motions.link_tree import RobotFile
from climbplan.motions.measure import measure_motion
from climbplan.motions.motion_file import read_motion_file
from climbplan.motions.pace import (
    MAX_PACE,
    ForceProblem,
    build_force_problem,
    find_fastest_pace,
    retime_motion,
)
from climbplan.motions.tracked_motion import TrackedMotion

URDF = Path(__file__).parents[2] / "specs" / "walker.urdf"


def build_sliding_mass(acceleration: float, friction: float) -> ForceProblem:
    """A point mass on level ground that is accelerated along x, in units of gravity."""
    sides = [
        (np.cos(a), np.sin(a), -friction * np.cos(np.pi / 8)) for a in 2 * np.pi * np.arange(8) / 8
    ]
    return ForceProblem(
        static_load=np.array([[0.0, 0, 1, 0, 0, 0]]),
        inertial_load=np.array([[acceleration, 0, 0, 0, 0, 0]]),
        force_map=-np.eye(6, 3).reshape(1, 6, 1, 3),
        torque_limit=np.zeros(0),
        cones=np.array([[[*sides, (0, 0, -1)]]]),
        is_touching=np.ones((1, 1), bool),
        weight=1.0,
        max_pace=MAX_PACE,
    )


def test_friction_ends_the_pace_of_a_sliding_mass() -> None:
    problem = build_sliding_mass(0.01, 0.5)
    expected = np.sqrt(0.5 * np.cos(np.pi / 8) / 0.01)
    assert find_fastest_pace(problem) == pytest.approx(expected, rel=0.01)
    assert problem.solve(0, 0.99 * expected) is not None
    assert problem.solve(0, 1.01 * expected) is None
    force = problem.solve(0, 3.0)
    assert force is not None
    assert force[0] == pytest.approx([0.09, 0, 1], abs=1e-9)


def test_speeds_end_it_where_forces_do_not() -> None:
    slow = replace(build_sliding_mass(0.0, 0.5), max_pace=4.0)
    assert find_fastest_pace(slow) == 4.0


def test_a_mass_that_cannot_rest_has_no_pace() -> None:
    floating = replace(build_sliding_mass(0.0, 0.5), is_touching=np.zeros((1, 1), bool))
    assert find_fastest_pace(floating) == 0.0


@pytest.fixture(scope="module")
def climb_motion(urdf_climb: Path) -> TrackedMotion:
    return read_tracked_motion(urdf_climb, 25.0)


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return read_robot(URDF)


def test_a_faster_motion_keeps_all_limits_by_inverse_dynamics(
    climb_motion: TrackedMotion, robot: RobotFile
) -> None:
    problem = build_force_problem(climb_motion, robot)
    pace = find_fastest_pace(problem)
    assert 1 < pace <= problem.max_pace
    fast = retime_motion(climb_motion, problem, pace)
    assert fast is not None
    assert fast.time[-1] == pytest.approx(climb_motion.time[-1] / pace)
    residual = {c.name: c.residual for c in measure_motion(fast, {"dynamics.balance": 1}, robot)}
    for name in ("joint.speed", "joint.torque", "contact.friction", "dynamics.torque"):
        assert residual[name] <= 1e-6, name
    assert residual["dynamics.balance"] <= 1e-6
    assert residual["contact.slip"] < 1e-3


def test_weaker_motors_are_slower(climb_motion: TrackedMotion, robot: RobotFile) -> None:
    """Between torques that just hold the robot and its own there are all paces."""
    problem = build_force_problem(climb_motion, robot)
    problem = replace(problem, inertial_load=100 * problem.inertial_load)
    paces = [
        find_fastest_pace(replace(problem, torque_limit=scale * problem.torque_limit))
        for scale in (1.0, 0.7, 0.4, 0.01)
    ]
    assert paces == sorted(paces, reverse=True)
    assert paces[0] > paces[-1] == 0.0
    assert retime_motion(climb_motion, problem, 1.01 * problem.max_pace) is None


def test_robots_whose_links_are_unknown_have_no_pace(
    motion: TrackedMotion, robot: RobotFile
) -> None:
    with pytest.raises(UsageError, match="no pace: the file has no joint"):
        build_force_problem(motion, robot)


def test_a_plan_is_exported_at_its_fastest_pace(
    urdf_climb: Path, climb_motion: TrackedMotion, robot: RobotFile, tmp_path: Path
) -> None:
    path = tmp_path / "fast.npz"
    command = ["export", str(urdf_climb), "--format", "motion", "-o", str(path)]
    assert run([*command, "--pace", "fastest"]) == 0
    fast = read_motion_file(path)
    pace = fast.facts["pace"]
    assert isinstance(pace, float)
    assert 1 < pace < MAX_PACE
    assert fast.fps == 50
    assert fast.time[-1] == pytest.approx(climb_motion.time[-1] / pace, abs=0.05)
    assert all(check.passed for check in measure_motion(fast, {}, robot))
    plan = climbplan.load_plan(urdf_climb)
    faster = read_motion_file(plan.export(tmp_path / "faster.npz", "motion", pace=1.1))
    assert faster.facts["pace"] == 1.1
    with pytest.raises(UsageError, match="expected with format 'motion'"):
        plan.export(tmp_path / "faster.csv", "npz", pace=2.0)


@pytest.mark.parametrize(
    ("pace", "message"),
    [("19.9", "do not move the links so fast"), ("100", "0.1 to 20"), ("swift", "or fastest")],
)
def test_paces_that_cannot_be(
    urdf_climb: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pace: str, message: str
) -> None:
    command = ["export", str(urdf_climb), "--format", "motion", "-o", str(tmp_path / "fast.npz")]
    assert run([*command, "--pace", pace]) == 2
    assert message in capsys.readouterr().err


def test_a_robot_without_masses_of_links_has_no_pace(
    climb: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", str(climb), "--format", "motion", "-o", str(tmp_path / "fast.npz")]
    assert run([*command, "--pace", "2"]) == 2
    assert "expected a robot from a URDF" in capsys.readouterr().err
