"""Flat feet of robots from URDFs: how soles lie, points that are pushed, and what is refused."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot, require_no_flat_feet
from climbplan.robots.facts import measure_robot
from climbplan.robots.kinematics import (
    point_hessian,
    point_jacobian,
    pushed_points,
    solve_inverse_kinematics,
    standing_inverse,
    toe_world,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.task_robot import heading_as
from climbplan.schema.robots.source import load_any_robot

SPECS = Path(__file__).parents[2] / "specs"
STEP = 1e-6


@pytest.fixture(scope="module")
def robot() -> Robot:
    return build_robot(load_climb(SPECS / "climb_biped.yaml", []).robot)


def soles(robot: Robot, rpy: Array, angles: Array) -> Array:
    """(N, 3, 3) columns across, along, normal of soles at angles (N, J), world."""
    assert isinstance(robot.mechanism, SerialChain)
    assert robot.sole is not None
    turns = robot.mechanism.pose(angles).turns[:, -1]
    return np.asarray(rotation_world_body(rpy) @ turns @ robot.sole.axes_zero)


def test_soles_lie_on_their_surfaces(robot: Robot) -> None:
    robot = heading_as(robot, np.array([0.0, 0.0, 0.3]))
    rpy, com = np.array([0.02, -0.03, 0.35]), np.array([0.1, 0.2, 0.5])
    turn = rotation_world_body(rpy)
    toes = com + robot.stance_body @ turn.T + [0.0, 0.0, 0.03]
    normal = np.array([[0.1, -0.05, 1.0], [0.0, 0.0, 1.0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = standing_inverse(robot, com, rpy, toes, normal)
    assert found.valid.all()
    angles = found.best()
    np.testing.assert_allclose(toe_world(robot, com, rpy, angles), toes, atol=1e-8)
    lie = soles(robot, rpy, angles)
    np.testing.assert_allclose(lie[..., 2], normal, atol=1e-8)
    np.testing.assert_allclose(lie[1, :, 1], [-np.sin(0.3), np.cos(0.3), 0.0], atol=1e-8)
    with pytest.raises(TypeError, match="flat feet"):
        solve_inverse_kinematics(robot, robot.stance_body)


def test_jacobians_are_those_of_the_corners(robot: Robot) -> None:
    rpy, com = np.array([0.02, -0.03, 0.1]), np.zeros(3)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (2, 3))
    toes = robot.stance_body + np.array([0.0, 0.0, 0.04])
    angles = standing_inverse(robot, com, rpy, toes, normal).best()
    assert robot.sole is not None
    corners = robot.sole.corners

    def points(q: Array) -> Array:
        lie = soles(robot, rpy, q)
        toe = toe_world(robot, com, rpy, q)
        return np.asarray(
            (toe[:, None] + corners @ np.swapaxes(lie[..., :2], -1, -2)).reshape(-1, 3)
        )

    np.testing.assert_allclose(points(angles), pushed_points(robot, toes, normal), atol=1e-8)
    jacobian = point_jacobian(robot, rpy, angles, normal)  # (8, 3, 6)
    hessian = point_hessian(robot, rpy, angles, normal)
    for joint in range(robot.joint_count):
        turned = np.zeros((2, robot.joint_count))
        turned[:, joint] = STEP
        ahead, behind = points(angles + turned), points(angles - turned)
        np.testing.assert_allclose(jacobian[:, :, joint], (ahead - behind) / (2 * STEP), atol=1e-8)
    # Second derivatives, twice by the knee
    step = np.zeros((2, robot.joint_count))
    step[:, 3] = 1e-4
    second = (points(angles + step) - 2 * points(angles) + points(angles - step)) / 1e-8
    np.testing.assert_allclose(hessian[:, :, 3, 3], second, atol=1e-5)


def test_a_biped_stands_on_its_soles(robot: Robot) -> None:
    facts = measure_robot(robot)
    assert facts.standing_force is not None
    assert facts.standing_force.sum() == pytest.approx(robot.weight, rel=1e-3)
    assert facts.standing_torque is not None
    # Twice as far from its centre of mass, of which soles reach 110 mm, it tips over
    away = replace(robot, stance_body=robot.stance_body + np.array([0.0, 0.12, 0.0]))
    assert measure_robot(away).standing_force is None


def section(folder: Path, old: str, new: str) -> SpecError:
    """What is told of the robot file with a piece of text in place of another."""
    for name in ("robot_biped.yaml", "biped.urdf"):
        shutil.copy(SPECS / name, folder)
    path = folder / "robot_biped.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(SpecError) as caught:
        build_robot(load_any_robot(str(path)))
    return caught.value


FOOT = "foot: {length: 0.22, width: 0.11}"


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        (FOOT, "foot: {length: 0.22}", "foot.length", "`width` beside it"),
        (FOOT, "foot: {width: 0.22}", "foot.width", "`length` beside it"),
        (FOOT, "foot: {}", "foot.radius", "or `length` and `width`"),
        (FOOT, "foot: {length: -1, width: 0.1}", "foot.length", "> 0"),
        (FOOT, "foot: {length: 1e-9, width: 0.1}", "foot.length", "from 0.0001 to 100 m"),
        (FOOT, "foot: {length: 0.2, width: 0.1, radius: 0.02}", "foot.length", "spheres of"),
        (FOOT, "foot: {length: 0.2, width: 0.1, center: 1}", "foot.center", ""),
        (FOOT, "foot: {length: 0.2, width: 0.1, height: 1}", "foot.height", "unknown key"),
        (FOOT, "foot: {radius: 0.02}", "legs", "at least three legs, got 2"),
        (FOOT, FOOT + "\nlocked: {L_ankle_roll: 0}", "legs.L.toe", "at least 6 joints"),
        ("L_ankle_pitch: -25", "L_ankle_pitch: 15", "legs.L.toe", "40 deg off"),
    ],
)
def test_what_cannot_be_a_flat_foot(
    old: str, new: str, key: str, words: str, tmp_path: Path
) -> None:
    told = [m for m in section(tmp_path, old, new).mistakes if m.key.endswith(key)]
    assert told
    assert words in str(told[0])
    assert told[0].line


def test_the_middle_of_the_sole_may_be_beside_the_toe(robot: Robot, tmp_path: Path) -> None:
    for name in ("robot_biped.yaml", "biped.urdf"):
        shutil.copy(SPECS / name, tmp_path)
    path = tmp_path / "robot_biped.yaml"
    path.write_text(path.read_text().replace(FOOT, FOOT[:-1] + ", center: [0.02, -0.01]}"))
    moved = build_robot(load_any_robot(str(path)))
    np.testing.assert_allclose(
        moved.stance_body - robot.stance_body, [[-0.01, 0.02, 0]] * 2, atol=1e-6
    )


def test_what_takes_feet_for_points_refuses_flat_ones() -> None:
    loaded = load_climb(SPECS / "climb_biped.yaml", []).robot
    with pytest.raises(SpecError, match="transitions would take them for points"):
        require_no_flat_feet(loaded, "transitions")
