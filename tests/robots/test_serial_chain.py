"""Chains of joints: the same as coxa-femur-tibia where they are that, and redundancy resolved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.errors import ReachFailure
from climbplan.robots.coxa_femur_tibia import JOINTS
from climbplan.robots.kinematics import (
    jacobian_body,
    joint_points_body,
    require_reachable,
    solve_inverse_kinematics,
    toe_hessian,
)
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.source import load_robot

AXES = np.array(
    [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float
)
JOINTS_AT = np.array(
    [
        [0, 0, 0],
        [0.05, 0, 0],
        [0.1, 0, 0],
        [0.25, 0, 0.05],
        [0.3, 0, 0.05],
        [0.45, 0, -0.1],
        [0.5, 0, -0.2],
    ]
)
SEVEN = SerialChain(
    (tuple("abcdefg"),),
    JOINTS_AT[None],
    AXES[None],
    np.array([[0.55, 0.0, -0.3]]),
    np.array([[0.0, -0.3, 0.1, 0.4, 0.0, 0.3, 0.2]]),
)
LOWER, UPPER = np.full((1, 7), -1.5), np.full((1, 7), 1.5)


@pytest.fixture(scope="module", name="silvia")
def _silvia() -> Robot:
    return Robot.from_spec(load_robot("silvia"))


@pytest.fixture(scope="module", name="chained")
def _chained(silvia: Robot) -> Robot:
    """SiLVIA told as chains."""
    yaw = silvia.mount_yaw
    out = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(6)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (6, 1))
    hinge = np.cross(out, up)
    coxa, femur, tibia = (silvia.link_lengths[:, j, None] for j in range(3))
    hip = silvia.shoulder_body + coxa * out
    knee = hip + femur * out
    chain = SerialChain(
        (JOINTS,) * 6,
        np.stack([silvia.shoulder_body, hip, knee], axis=1),
        np.stack([up, hinge, hinge], axis=1),
        knee - tibia * up,
        solve_inverse_kinematics(silvia, silvia.stance_body).best(),
    )
    return replace(silvia, mechanism=chain)


def test_silvia_as_chains_is_silvia(silvia: Robot, chained: Robot) -> None:
    rng = np.random.default_rng(0)
    angles = rng.uniform(silvia.joint_lower, silvia.joint_upper, (50, 6, 3))
    for of in (joint_points_body, jacobian_body, toe_hessian):
        np.testing.assert_allclose(of(chained, angles), of(silvia, angles), atol=1e-14)


def test_chains_find_the_posture_of_the_closed_form(silvia: Robot, chained: Robot) -> None:
    toes = silvia.stance_body + np.random.default_rng(1).uniform(-0.15, 0.15, (300, 6, 3))
    closed, found = solve_inverse_kinematics(silvia, toes), solve_inverse_kinematics(chained, toes)
    np.testing.assert_array_equal(found.valid, closed.within_bounds[:, 0])
    assert 0.5 < found.valid.mean() < 0.95
    both = found.valid
    np.testing.assert_allclose(found.best()[both], closed.best()[both], atol=1e-7)


def random_angles(count: int) -> Array:
    return np.random.default_rng(2).uniform(-1.2, 1.2, (count, 1, 7))


def test_jacobian_and_hessian_by_differences() -> None:
    angles, step = random_angles(20), 1e-6
    for joint in range(7):
        shift = step * np.eye(7)[joint]
        ahead, behind = angles + shift, angles - shift
        slope = (SEVEN.pose(ahead).toe - SEVEN.pose(behind).toe) / (2 * step)
        np.testing.assert_allclose(SEVEN.jacobian(angles)[..., joint], slope, atol=1e-9)
        turn = (SEVEN.jacobian(ahead) - SEVEN.jacobian(behind)) / (2 * step)
        np.testing.assert_allclose(SEVEN.hessian(angles)[..., joint], turn, atol=1e-8)


def test_seven_joints_take_the_nearest_posture() -> None:
    """No other way to the same toe within the bounds is nearer to the limb's own posture."""
    toes = SEVEN.pose(random_angles(100)).toe
    found = SEVEN.inverse(toes, LOWER, UPPER)
    assert found.valid.mean() > 0.9
    angles = found.angles[:, 0][found.valid]
    np.testing.assert_allclose(SEVEN.pose(angles[:, None]).toe[:, 0], toes[found.valid], atol=1e-8)
    home = SEVEN.posture[0]
    inside = (np.abs(angles) < 1.5 - 1e-9).all(axis=1)
    assert inside.sum() > 30
    for own in angles[inside]:
        jacobian = SEVEN.jacobian(own[None])[0]
        free = home - own - np.linalg.pinv(jacobian) @ (jacobian @ (home - own))
        np.testing.assert_allclose(free, 0.0, atol=1e-8)


def test_angles_follow_a_path_without_a_jump_and_come_back() -> None:
    share = np.linspace(0.0, 1.0, 801)[:, None, None]
    start = SEVEN.pose(SEVEN.posture).toe
    out = start + share * np.array([0.03, 0.25, 0.15])
    path = np.concatenate([out, out[::-1]])
    found = SEVEN.inverse(path, LOWER, UPPER)
    assert found.valid.all()
    angles = found.best()[:, 0]
    steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    toe_step = np.linalg.norm(np.diff(path[:, 0], axis=0), axis=1).max()
    assert steps.max() < 8 * toe_step  # some rad a metre, no jump
    np.testing.assert_allclose(angles, angles[::-1], atol=1e-12)
    np.testing.assert_allclose(angles[0], SEVEN.posture[0], atol=1e-9)


def test_a_limb_with_fewer_joints_begins_with_none(chained: Robot) -> None:
    chain = chained.mechanism
    assert isinstance(chain, SerialChain)
    none = np.zeros((6, 1, 3))
    padded = SerialChain(
        (("", *JOINTS),) * 6,
        np.concatenate([chain.joint_zero[:, :1], chain.joint_zero], axis=1),
        np.concatenate([none, chain.axis_zero], axis=1),
        chain.toe_zero,
        np.concatenate([np.zeros((6, 1)), chain.posture], axis=1),
    )
    toes = chained.stance_body + np.array([0.0, 0.05, 0.05])
    bounds = [
        np.concatenate([np.full((6, 1), end), own], axis=1)
        for end, own in ((-1.0, chained.joint_lower), (1.0, chained.joint_upper))
    ]
    found = padded.inverse(toes, *bounds)
    assert found.valid.all()
    expected = solve_inverse_kinematics(chained, toes).best()
    np.testing.assert_allclose(found.best()[:, 1:], expected, atol=1e-8)
    np.testing.assert_array_equal(found.best()[:, 0], 0.0)
    np.testing.assert_array_equal(padded.jacobian(found.best())[..., 0], 0.0)


def test_out_of_reach_in_the_limbs_own_terms(chained: Robot) -> None:
    wide = replace(chained, joint_upper=chained.joint_upper + 0.5)
    far = chained.stance_body.copy()
    far[1] = chained.shoulder_body[1] + [0.7, 0.0, 0.0]
    with pytest.raises(
        ReachFailure, match=r"round 3: RM cannot reach its toe: too far by 7\d\.\d mm"
    ):
        require_reachable(wide, far, "round 3")
    aside = chained.stance_body.copy()
    aside[1] = chained.shoulder_body[1] + [0.1, 0.4, -0.2]
    with pytest.raises(ReachFailure, match="RM cannot reach its toe: stopped by the bound of coxa"):
        require_reachable(chained, aside, "")
