"""The verifier's own geometry against the planner's and against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from example_climb import Climb
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from climbplan.climb.check.anew.kinematics import (
    build_limbs,
    compute_body_axes,
    solve_standing_limbs,
    transform_to_world,
)
from climbplan.climb.check.convex import (
    ConvexBody,
    bound_hull_distance,
    build_hull,
    measure_body_clearance,
    measure_chain_separation,
)
from climbplan.robots.kinematics import jacobian_world, joint_points_body, toe_world
from climbplan.robots.rotations import rotation_world_body

SEEDS = st.integers(0, 2**32 - 1)


def test_rotation_and_limbs_agree_with_the_planner(climb: Climb) -> None:
    robot = climb.scene.robot
    draw = np.random.default_rng(1)
    com, rpy = draw.normal(size=(50, 3)), draw.uniform(-3, 3, (50, 3))
    angles = draw.uniform(-3, 3, (50, robot.limb_count, 3))
    axes = compute_body_axes(rpy)
    np.testing.assert_allclose(np.swapaxes(axes, -1, -2), rotation_world_body(rpy), atol=1e-14)
    limbs = build_limbs(robot, com, axes, angles)
    np.testing.assert_allclose(limbs.toe, toe_world(robot, com, rpy, angles), atol=1e-14)
    np.testing.assert_allclose(limbs.jacobian(), jacobian_world(robot, rpy, angles), atol=1e-14)
    joints = joint_points_body(robot, angles).reshape(50, -1, 3)
    rotated = np.einsum("pij,pvj->pvi", rotation_world_body(rpy), joints) + com[:, None]
    np.testing.assert_allclose(limbs.points.reshape(50, -1, 3), rotated, atol=1e-14)


def test_jacobian_is_the_derivative_of_the_toe(climb: Climb) -> None:
    robot = climb.scene.robot
    draw = np.random.default_rng(2)
    com, axes = np.zeros(3), compute_body_axes(np.array([0.2, -0.3, 0.5]))
    angles = draw.uniform(-1.5, 1.5, (robot.limb_count, 3))
    jacobian = build_limbs(robot, com, axes, angles).jacobian()
    step = 1e-6
    for joint in range(3):
        shift = step * np.eye(3)[joint]
        ahead = build_limbs(robot, com, axes, angles + shift).toe
        behind = build_limbs(robot, com, axes, angles - shift).toe
        np.testing.assert_allclose(jacobian[..., joint], (ahead - behind) / (2 * step), atol=1e-8)


def test_standing_limbs_find_the_angles_back(climb: Climb) -> None:
    robot = climb.scene.robot
    draw = np.random.default_rng(3)
    shape = (200, robot.limb_count, 3)
    angles = draw.uniform([-0.7, -0.5, -1.4], [0.7, 1.2, 2.0], shape)
    # Stretched limbs can bend either way from there.
    angles[..., 2] += np.where(np.abs(angles[..., 2] - np.pi / 2) < 0.1, 0.3, 0.0)
    com, axes = draw.normal(size=(200, 3)), compute_body_axes(draw.uniform(-1, 1, (200, 3)))
    limbs = build_limbs(robot, com, axes, angles)
    alike = angles + draw.uniform(-0.02, 0.02, shape)
    # A toe below its shoulder says nothing about the coxa.
    reach = limbs.toe - limbs.joints[..., 0, :]
    beside = np.linalg.norm(np.cross(reach, limbs.axes[..., 0, :]), axis=-1) > 5e-3
    standing = solve_standing_limbs(robot, com, axes, limbs.toe, initial=alike, command=alike)
    assert beside.mean() > 0.95
    np.testing.assert_allclose(standing.angles[beside], angles[beside], atol=1e-7)
    np.testing.assert_allclose(standing.points[beside], limbs.points[beside], atol=1e-9)
    assert np.abs(standing.missing).max() < 1e-12


def test_missing_reach_is_measured(climb: Climb) -> None:
    robot = climb.scene.robot
    com, axes = np.zeros(3), compute_body_axes(np.zeros(3))
    angles = np.tile([0.0, 0.3, np.pi / 2], (robot.limb_count, 1))  # stretched
    limbs = build_limbs(robot, com, axes, angles)
    shin = limbs.toe - limbs.joints[:, 2]
    beyond = limbs.toe + 0.01 * shin / np.linalg.norm(shin, axis=1, keepdims=True)
    standing = solve_standing_limbs(robot, com, axes, beyond, initial=angles, command=angles)
    np.testing.assert_allclose(standing.missing, 0.01, atol=1e-9)


def random_hull(draw: np.random.Generator, centre: np.ndarray, size: float) -> ConvexBody:
    return build_hull("hull", centre + size * draw.uniform(-1, 1, (10, 3)))


def nearest_by_optimisation(first: np.ndarray, second: np.ndarray) -> float:
    """Distance of two hulls by a general solver over convex weights."""
    k = len(first)

    def gap(w: np.ndarray) -> float:
        return float(np.sum((w[:k] @ first - w[k:] @ second) ** 2))

    both = len(first) + len(second)
    result = minimize(
        gap,
        np.r_[np.full(k, 1 / k), np.full(both - k, 1 / (both - k))],
        bounds=[(0, 1)] * both,
        constraints=[
            {"type": "eq", "fun": lambda w: w[:k].sum() - 1},
            {"type": "eq", "fun": lambda w: w[k:].sum() - 1},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return float(np.sqrt(result.fun))


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_hull_distance_is_the_least_distance(seed: int) -> None:
    draw = np.random.default_rng(seed)
    first = random_hull(draw, np.zeros(3), 0.3).corners
    second = random_hull(draw, draw.uniform(-1, 1, 3), 0.3).corners
    distance = bound_hull_distance(first, second)
    assert distance == pytest.approx(nearest_by_optimisation(first, second), abs=2e-4)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_body_clearance_bounds_the_distance_and_settles_the_question(seed: int) -> None:
    draw = np.random.default_rng(seed)
    body, asked = random_hull(draw, np.zeros(3), 0.3), 0.05
    solid = random_hull(draw, np.array([0.7, 0.1, 0.0]), 0.3)
    share = np.linspace(0, 1, 40)[:, None]
    com = share * draw.uniform(-1, 1, 3)
    axes = compute_body_axes(share * draw.uniform(-1, 1, 3))
    clear = measure_body_clearance(com, axes, body, solid, asked)
    exact = np.array(
        [
            bound_hull_distance(hull, solid.corners)
            for hull in transform_to_world(com, axes, body.corners)
        ]
    )
    assert (clear <= exact + 1e-9).all()
    assert ((clear >= asked) == (exact >= asked)).all()
    close = (clear < asked) & (exact > 0)
    np.testing.assert_allclose(clear[close], exact[close], atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_segments_are_as_deep_as_their_deepest_point(seed: int) -> None:
    draw = np.random.default_rng(seed)
    solid = random_hull(draw, np.zeros(3), 0.3)
    starts, ends = draw.uniform(-0.8, 0.8, (2, 50, 3))
    separation = measure_chain_separation(np.stack([starts, ends], axis=-2), solid, 0.0)[:, 0]
    share = np.linspace(0, 1, 4001)[:, None, None]
    points = starts + share * (ends - starts)
    sampled = solid.face_distances(points).max(axis=-1).min(axis=0)
    assert (separation <= sampled + 1e-12).all()
    close = separation < 0
    np.testing.assert_allclose(separation[close], sampled[close], atol=1e-3)
    assert ((sampled < 0) <= (separation < 0)).all()
