"""Spherical feet: where they touch, how the touching point moves, and what cannot be a foot."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import (
    contact_hessian,
    contact_jacobian,
    contact_points,
    jacobian_world,
    toe_world,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body

SPECS = Path(__file__).parents[2] / "specs"
RADIUS = 0.03
STEP = 1e-6
GRIPPER = (
    "gripper: {length: 0.07, finger_span: 0.07, max_force: 60, wrist_max_torque: [5, 5, 5], "
    "wrist_lower_deg: [-90, -90, -180], wrist_upper_deg: [90, 90, 180]}"
)


def walker(folder: Path, foot: str) -> Robot:
    """The robot of climb_walker.yaml with a line about its feet."""
    for name in ("climb_walker.yaml", "robot_walker.yaml", "walker.urdf"):
        shutil.copy(SPECS / name, folder)
    robot = folder / "robot_walker.yaml"
    robot.write_text(robot.read_text() + f"\n{foot}\n")
    return build_robot(load_climb(folder / "climb_walker.yaml", []).robot)


@pytest.fixture(scope="module")
def footed(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return walker(tmp_path_factory.mktemp("feet"), f"foot: {{radius: {RADIUS}}}")


def posture(robot: Robot) -> tuple[Array, Array, Array]:
    """Rotation, angles and normals of one pose."""
    rng = np.random.default_rng(3)
    angles = 0.4 * rng.normal(size=robot.max_torque.shape)
    normal = rng.normal(size=(robot.limb_count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.array([0.1, -0.2, 0.3]), angles, normal


def touching(robot: Robot, rpy: Array, angles: Array, at: Array, normal: Array) -> Array:
    """Where the points of last links are at `angles` that touch at angles `at`, (N, 3)."""
    turns = [robot.limbs.pose(q).turns[:, -1] for q in (angles, at)]  # type: ignore[attr-defined]
    body = rotation_world_body(rpy)
    fixed = np.einsum("nji,kj,nk->ni", turns[1], body, -RADIUS * normal)  # to zero angles
    moved = np.einsum("ij,njk,nk->ni", body, turns[0], fixed)
    return toe_world(robot, np.zeros(3), rpy, angles) + moved


def test_the_jacobian_is_that_of_the_point_that_touches(footed: Robot) -> None:
    rpy, angles, normal = posture(footed)
    jacobian = contact_jacobian(footed, rpy, angles, normal)
    hessian = contact_hessian(footed, rpy, angles, normal)
    np.testing.assert_allclose(
        touching(footed, rpy, angles, angles, normal),
        contact_points(footed, toe_world(footed, np.zeros(3), rpy, angles), normal),
        atol=1e-12,
    )
    for joint in range(footed.joint_count):
        turned = np.zeros_like(angles)
        turned[:, joint] = STEP
        ahead, behind = (
            touching(footed, rpy, angles + s * turned, angles, normal) for s in (1.0, -1.0)
        )
        np.testing.assert_allclose((ahead - behind) / (2 * STEP), jacobian[..., joint], atol=1e-8)

        def at(q: Array) -> Array:
            """The Jacobian of the same points of the links elsewhere."""
            columns = []
            for other in range(footed.joint_count):
                more = np.zeros_like(q)
                more[:, other] = 1e-4
                ends = [touching(footed, rpy, q + s * more, angles, normal) for s in (1.0, -1.0)]
                columns.append((ends[0] - ends[1]) / 2e-4)
            return np.stack(columns, axis=-1)

        slope = (at(angles + 1e3 * turned) - at(angles - 1e3 * turned)) / (2e3 * STEP)
        np.testing.assert_allclose(slope, hessian[..., joint], atol=2e-6)


def test_point_toes_touch_where_they_are(footed: Robot, tmp_path: Path) -> None:
    points = walker(tmp_path, "")
    rpy, angles, normal = posture(points)
    assert points.foot is None
    assert points.standoff == 0.0
    toes = toe_world(points, np.zeros(3), rpy, angles)
    assert np.array_equal(contact_points(points, toes, normal), toes)
    plain = jacobian_world(points, rpy, angles)
    assert np.array_equal(contact_jacobian(points, rpy, angles, normal), plain)
    assert footed.standoff == RADIUS


@pytest.mark.parametrize(
    ("foot", "key", "words"),
    [
        ("foot: {radius: -0.02}", "foot.radius", "> 0"),
        ("foot: {radius: 0}", "foot.radius", "> 0"),
        ("foot: {radius: .nan}", "foot.radius", ""),
        ("foot: {radius: .inf}", "foot.radius", ""),
        ("foot: {radius: 1e-9}", "foot.radius", "from 0.0001 to 100 m"),
        ("foot: {radius: [0.02, 0.02]}", "foot.radius", ""),
        ("foot: {}", "foot.radius", ""),
        ("foot: {radis: 0.02}", "foot.radis", "unknown key"),
        ("foot: 0.02", "foot", ""),
        (f"{GRIPPER}\nfoot: {{radius: 0.02}}", "foot", "grippers or feet at the toes, got both"),
        ("foot: {radius: 0.5}", "foot.radius", "distance of L1's toe from its joint"),
    ],
)
def test_what_cannot_be_a_foot(foot: str, key: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError) as caught:
        walker(tmp_path, foot)
    told = [m for m in caught.value.mistakes if m.key.endswith(key)]
    assert told, caught.value
    assert words in str(told[0])
