"""Kinematics against finite differences, round trips, and the published lengths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from climbplan.errors import ReachFailure
from climbplan.robots.kinematics import (
    jacobian_body,
    jacobian_world,
    joint_points_body,
    require_reachable,
    solve_inverse_kinematics,
    to_body,
    toe_body,
    toe_hessian,
    toe_world,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.schema.robots.source import load_robot


@pytest.fixture(scope="module")
def silvia() -> Robot:
    from pathlib import Path

    return Robot.from_spec(load_robot("silvia", Path.cwd()))


def random_angles(robot: Robot, seed: int, count: int = 20) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.joint_lower, robot.joint_upper, (count, robot.limb_count, 3))


def test_published_lengths_and_zero_pose(silvia: Robot) -> None:
    """At zero angles the femur points along the mount yaw and the tibia straight down."""
    assert silvia.mass == 10.3
    np.testing.assert_allclose(silvia.link_lengths, np.tile([0.057, 0.195, 0.375], (6, 1)))
    toes = toe_body(silvia, np.zeros((6, 3)))
    rm = silvia.limb_names.index("RM")
    np.testing.assert_allclose(toes[rm], [0.224 + 0.057 + 0.195, 0.0, -0.375], atol=1e-12)
    rf = silvia.limb_names.index("RF")
    out = 0.252 * np.array([np.cos(np.pi / 3), np.sin(np.pi / 3)])
    np.testing.assert_allclose(toes[rf, :2], np.array([0.111, 0.194]) + out, atol=1e-12)


def test_links_keep_their_lengths(silvia: Robot) -> None:
    points = joint_points_body(silvia, random_angles(silvia, 1))
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(silvia.link_lengths, lengths.shape))


def test_jacobian_matches_finite_differences(silvia: Robot) -> None:
    angles = random_angles(silvia, 2)
    jacobian = jacobian_body(silvia, angles)
    step = 1e-6
    for joint in range(3):
        shift = np.zeros(3)
        shift[joint] = step
        difference = (toe_body(silvia, angles + shift) - toe_body(silvia, angles - shift)) / (
            2 * step
        )
        np.testing.assert_allclose(jacobian[..., joint], difference, atol=1e-8)


def test_hessian_is_the_slope_of_the_jacobian(silvia: Robot) -> None:
    angles = np.random.default_rng(4).uniform(-1, 1, (20, 6, 3))
    hessian, step = toe_hessian(silvia, angles), 1e-6
    np.testing.assert_array_equal(hessian, np.swapaxes(hessian, -1, -2))
    for joint in range(3):
        shift = step * np.eye(3)[joint]
        ahead, behind = (jacobian_body(silvia, angles + s * shift) for s in (1, -1))
        np.testing.assert_allclose(hessian[..., joint], (ahead - behind) / (2 * step), atol=1e-8)


def test_world_jacobian_turns_with_the_body(silvia: Robot) -> None:
    angles = random_angles(silvia, 3, count=4)
    rpy = np.random.default_rng(3).uniform(-0.5, 0.5, (4, 3))
    com = np.zeros((4, 3))
    step = 1e-6
    shift = np.array([0, step, 0])
    difference = (
        toe_world(silvia, com, rpy, angles + shift) - toe_world(silvia, com, rpy, angles - shift)
    ) / (2 * step)
    np.testing.assert_allclose(jacobian_world(silvia, rpy, angles)[..., 1], difference, atol=1e-8)


def test_inverse_finds_the_angles_again(silvia: Robot) -> None:
    angles = random_angles(silvia, 4, count=300)
    solution = solve_inverse_kinematics(silvia, toe_body(silvia, angles))
    assert solution.valid.all()
    error = np.abs(solution.angles - angles[:, None]).max(axis=-1)  # (300, 4, N)
    assert error.min(axis=1).max() < 1e-6  # one of the branches is the one we started from
    again = toe_body(silvia, solution.best())
    np.testing.assert_allclose(again, toe_body(silvia, angles), atol=1e-12)


def test_every_branch_reaches_the_toe(silvia: Robot) -> None:
    toes = toe_body(silvia, random_angles(silvia, 5, count=50))
    solution = solve_inverse_kinematics(silvia, toes)
    reached = toe_body(silvia, np.moveaxis(solution.angles, -3, 0))  # (4, 50, N, 3)
    error = np.linalg.norm(reached - toes, axis=-1)
    reachable = np.moveaxis(solution.reachable, -2, 0)
    assert reachable.any()
    assert error[reachable].max() < 1e-9


def test_reach_failures_say_what_is_missing(silvia: Robot) -> None:
    toes = silvia.stance_body.copy()
    lm = silvia.limb_names.index("LM")
    toes[lm] = silvia.shoulder_body[lm] + [-0.057 - 0.57 - 0.031, 0.0, 0.0]
    with pytest.raises(ReachFailure) as failure:
        require_reachable(silvia, toes, "round 3, LM lifted")
    assert failure.value.limb == "LM"
    assert failure.value.missing == pytest.approx(0.031, abs=1e-9)
    assert "round 3, LM lifted: LM cannot reach its toe: too far by 31.0 mm" in str(failure.value)

    toes = silvia.stance_body.copy()
    toes[lm] = silvia.shoulder_body[lm] + [-0.057 - 0.1, 0.0, 0.0]
    with pytest.raises(ReachFailure, match=r"LM cannot reach its toe: too near by 80\.0 mm"):
        require_reachable(silvia, toes, "")

    toes = silvia.stance_body.copy()
    toes[lm] = silvia.shoulder_body[lm] + [-0.2, 0.35, 0.0]
    with pytest.raises(ReachFailure, match=r"coxa 1[0-9]\.\d deg past its bound"):
        require_reachable(silvia, toes, "")


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_rotations_are_orthonormal_and_in_order(rpy: list[float]) -> None:
    roll, pitch, yaw = rpy
    about_x = rotation_world_body(np.array([roll, 0, 0]))
    about_y = rotation_world_body(np.array([0, pitch, 0]))
    about_z = rotation_world_body(np.array([0, 0, yaw]))
    whole = rotation_world_body(np.array(rpy))
    np.testing.assert_allclose(whole, about_z @ about_y @ about_x, atol=1e-12)
    np.testing.assert_allclose(whole @ whole.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(whole) == pytest.approx(1)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", skew(a), b), np.cross(a, b))


def test_to_body_inverts_the_pose() -> None:
    rng = np.random.default_rng(1)
    com, rpy, points = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.normal(size=(4, 6, 3))
    body = to_body(com, rpy, points)
    world = com[:, None] + np.einsum("kij,knj->kni", rotation_world_body(rpy), body)
    np.testing.assert_allclose(world, points, atol=1e-12)
