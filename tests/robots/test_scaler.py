"""SCALER's five-bar legs: closed forms against each other, the published zero posture, wrists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.check.anew.five_bars import build_five_bars, solve_five_bars
from climbplan.errors import SpecError
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.gripper import wrists_at
from climbplan.robots.kinematics import jacobian_body, solve_inverse_kinematics, toe_body
from climbplan.robots.last_link import joint_axes_body, last_link_body
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_robot, read_robot_text

STEP = 1e-6


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_spec(load_robot("scaler"))


@pytest.fixture(scope="module")
def legs(robot: Robot) -> FiveBar:
    assert isinstance(robot.mechanism, FiveBar)
    return robot.mechanism


@pytest.fixture(scope="module")
def angles(robot: Robot) -> np.ndarray:
    """Postures about the stance, within the joint bounds."""
    rng = np.random.default_rng(0)
    toes = robot.stance_body + rng.uniform(-0.05, 0.05, (60, 4, 3))
    solution = solve_inverse_kinematics(robot, toes)
    return solution.best()[solution.valid.all(axis=1)]


def test_zero_posture_is_the_published_one(legs: FiveBar) -> None:
    """Crank F straight out, crank A straight down: the URDF has the last link at 1.17617 rad."""
    plane = legs.plane(np.broadcast_to([0.0, np.pi / 2, 0.0], (4, 3)))
    np.testing.assert_allclose(plane.tilt, np.pi / 2 - 1.17617, atol=3e-3)


def test_inverse_finds_the_angles_again(robot: Robot, angles: np.ndarray) -> None:
    assert len(angles) > 30
    solution = solve_inverse_kinematics(robot, toe_body(robot, angles))
    assert solution.valid.all()
    np.testing.assert_allclose(solution.best(), angles, atol=1e-9)


def test_linkage_closes(legs: FiveBar, angles: np.ndarray) -> None:
    """The coupler's ends are its length apart, worked out point by point."""
    bar, plane = legs.linkage, legs.plane(angles)
    along = np.stack([np.sin(plane.tilt), -np.cos(plane.tilt)], axis=-1)
    across = np.stack([np.cos(plane.tilt), np.sin(plane.tilt)], axis=-1)
    held = plane.elbow + bar.held_along * along + bar.held_across * across
    down = np.stack([np.sin(angles[..., 2]), -np.cos(angles[..., 2])], axis=-1)
    end = np.array([bar.offset, bar.axis_a]) + bar.crank_a * down
    np.testing.assert_allclose(np.linalg.norm(held - end, axis=-1), bar.coupler, atol=1e-12)


def test_jacobian_turning_and_hessian_by_differences(robot: Robot, angles: np.ndarray) -> None:
    legs = robot.limbs
    rows = joint_axes_body(robot, angles)
    for joint in range(3):
        change = np.zeros(3)
        change[joint] = STEP
        moved = toe_body(robot, angles + change) - toe_body(robot, angles - change)
        jacobian = jacobian_body(robot, angles)[..., joint]
        np.testing.assert_allclose(moved / (2 * STEP), jacobian, atol=1e-8)
        link = last_link_body(robot, angles + change) - last_link_body(robot, angles - change)
        expected = np.cross(rows[..., joint, None, :], last_link_body(robot, angles))
        np.testing.assert_allclose(link / (2 * STEP), expected, atol=1e-7)
    hessian = legs.hessian(angles)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, -1, -2), atol=1e-6)


def test_checks_build_the_same_legs_anew(robot: Robot, legs: FiveBar, angles: np.ndarray) -> None:
    anew = build_five_bars(legs, angles)
    np.testing.assert_allclose(anew.toe, toe_body(robot, angles), atol=1e-12)
    columns = np.cross(anew.axes, anew.toe[..., None, :] - anew.joints)
    jacobian = np.swapaxes(columns, -1, -2) @ anew.drive
    np.testing.assert_allclose(jacobian, jacobian_body(robot, angles), atol=1e-8)
    turning = np.swapaxes(anew.drive, -1, -2) @ anew.axes
    np.testing.assert_allclose(turning, joint_axes_body(robot, angles), atol=1e-8)
    settled = solve_five_bars(legs, anew.toe, angles + 0.05)
    np.testing.assert_allclose(settled, angles, atol=1e-9)


def test_workspace_ball_holds_bounds_and_wrists_on_a_flat_wall(robot: Robot) -> None:
    """Within stance_radius of the stance, in a plane along the belly, everything holds."""
    assert robot.gripper is not None
    turn = np.linspace(0, 2 * np.pi, 48)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    for radius in (0.0, 0.5, 1.0):
        toes = robot.stance_body + radius * robot.stance_radius * ring[:, None]
        solution = solve_inverse_kinematics(robot, toes)
        assert solution.valid.all()
        found = solution.best()
        down = np.broadcast_to([0.0, 0, -1], found.shape)
        forward = np.broadcast_to([0.0, 1, 0], found.shape)
        wrists = wrists_at(last_link_body(robot, found), down, forward)
        assert (wrists.angles >= robot.gripper.wrist_lower).all()
        assert (wrists.angles <= robot.gripper.wrist_upper).all()
        np.testing.assert_allclose(wrists.axes[..., 2, :], down, atol=1e-12)


def test_out_of_reach_is_said(robot: Robot) -> None:
    toes = robot.stance_body.copy()
    toes[0] += [0.0, 0.3, 0.0]
    solution = solve_inverse_kinematics(robot, toes)
    found = robot.limbs.explain_miss(solution, toes, 0, robot.joint_lower, robot.joint_upper)
    assert found.reason == "too far"
    assert found.missing > 0.1
    toes[0] = robot.stance_body[0] + [0.0, 0.0, 0.12]
    solution = solve_inverse_kinematics(robot, toes)
    found = robot.limbs.explain_miss(solution, toes, 0, robot.joint_lower, robot.joint_upper)
    assert "crank" in found.reason or "close" in found.reason


def test_robot_file_says_when_the_coupler_is_too_long(tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(read_robot_text("scaler").replace("coupler: 0.142", "coupler: 1.42"))
    with pytest.raises(SpecError, match="nothing ever closes"):
        load_robot(bad)
