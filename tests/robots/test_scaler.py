"""SCALER's data: what the robot file derives from the five-bar linkage holds on the linkage."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.robots.gripper import wrists_at
from climbplan.robots.kinematics import inverse, jacobian_body, toe_body
from climbplan.robots.last_link import joint_axes_body, last_link_body
from climbplan.robots.model import Robot
from climbplan.spec.robot_source import load_robot

CRANK, COUPLER, LINK = 0.113, 0.142, 0.21755  # [m] published
AXIS_A, AXIS_F = -0.0713, -0.0998  # [m] of the cranks' axes, below the shoulder
JOINT_C = np.array([0.1333, -0.03475])  # [m] where the coupler holds the last link
MOTOR = 10.0  # [N m] of a motor pair
CRANK_A = (-1.0, 0.6)  # [rad] from straight down, published
CRANK_F = (0.97 - np.pi / 2, 2.37 - np.pi / 2)  # [rad] from straight out, published


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_spec(load_robot("scaler"))


def crank_a(femur: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Angle of crank A from straight down, for the femur's elevation and the last link's tilt."""
    elbow = np.stack([CRANK * np.cos(femur), AXIS_F + CRANK * np.sin(femur)], axis=-1)
    along = np.stack([np.sin(tilt), -np.cos(tilt)], axis=-1)
    across = np.stack([np.cos(tilt), np.sin(tilt)], axis=-1)
    reach = elbow + JOINT_C[0] * along + JOINT_C[1] * across - [0.0, AXIS_A]
    distance = np.linalg.norm(reach, axis=-1)
    inner = np.arccos((CRANK**2 + distance**2 - COUPLER**2) / (2 * CRANK * distance))
    return np.arctan2(reach[..., 0], -reach[..., 1]) - inner


def test_linkage_closes_where_the_published_model_has_it() -> None:
    """The URDF at zero: crank F straight out, crank A straight down, last link at -67.4 deg."""
    assert crank_a(np.zeros(1), np.array([np.pi / 2 - 1.17617]))[0] == pytest.approx(0, abs=3e-3)


def test_joint_box_keeps_both_cranks_within_their_bounds(robot: Robot) -> None:
    low, high = robot.joint_lower, robot.joint_upper
    for limb in range(robot.limb_count):
        femur, tibia = np.meshgrid(
            *(np.linspace(low[limb, j], high[limb, j], 41) for j in (1, 2)), indexing="ij"
        )
        angle = crank_a(femur, femur + tibia)
        assert angle.min() >= CRANK_A[0]
        assert angle.max() <= CRANK_A[1]
        assert femur.min() >= CRANK_F[0]
        assert femur.max() <= CRANK_F[1] + 3e-3  # 45.8 deg, rounded to 46


def test_torque_box_keeps_both_motors_within_their_limits(robot: Robot) -> None:
    """Virtual work on the linkage: tau_F and tau_A of every corner of the box, every posture."""
    low, high, step = robot.joint_lower[0], robot.joint_upper[0], 1e-6
    femur, tibia = np.meshgrid(*(np.linspace(low[j], high[j], 41) for j in (1, 2)), indexing="ij")
    tilt = femur + tibia
    by_tilt = (crank_a(femur, tilt + step) - crank_a(femur, tilt - step)) / (2 * step)
    by_femur = (crank_a(femur + step, tilt) - crank_a(femur - step, tilt)) / (2 * step)
    _, at_femur, at_tibia = robot.max_torque[0]
    for sign in (1.0, -1.0):
        # d(work) = tau_femur dfemur + tau_tibia (dtilt - dfemur) = tau_F dfemur + tau_A dA
        tau_a = sign * at_tibia / by_tilt
        tau_f = at_femur - sign * at_tibia - tau_a * by_femur
        assert np.abs(tau_a).max() <= MOTOR
        assert np.abs(tau_f).max() <= MOTOR
    assert np.abs(at_femur + at_tibia / by_tilt * (by_tilt + by_femur)).max() > 0.95 * MOTOR


def test_stance_is_reached_and_wrists_stand_square(robot: Robot) -> None:
    assert robot.gripper is not None
    solution = inverse(robot, robot.stance_body)
    assert solution.valid.all()
    angles = solution.best()
    np.testing.assert_allclose(toe_body(robot, angles), robot.stance_body, atol=1e-12)
    down, forward = np.tile([0.0, 0, -1], (4, 1)), np.tile([0.0, 1, 0], (4, 1))
    found = wrists_at(last_link_body(robot, angles), down, forward)
    assert (found.angles > robot.gripper.wrist_lower).all()
    assert (found.angles < robot.gripper.wrist_upper).all()
    np.testing.assert_allclose(found.axes[:, 2], down, atol=1e-12)


def test_joint_axes_turn_the_last_link_as_the_toe_moves(robot: Robot) -> None:
    angles = inverse(robot, robot.stance_body).best()
    axes, step = joint_axes_body(robot, angles), 1e-6
    for joint in range(3):
        change = np.zeros((4, 3))
        change[:, joint] = step
        turned = last_link_body(robot, angles + change) - last_link_body(robot, angles - change)
        expected = np.cross(axes[:, joint, None], last_link_body(robot, angles))
        np.testing.assert_allclose(turned / (2 * step), expected, atol=1e-8)
    # The toe is on the last link: its velocity by the tibia is axis x link.
    link = robot.link_lengths[:, 2, None] * last_link_body(robot, angles)[:, 0]
    by_tibia = jacobian_body(robot, angles)[..., 2]
    np.testing.assert_allclose(by_tibia, np.cross(axes[:, 2], link), atol=1e-12)
