"""Capsules of a URDF's legs hold its collision geometry, and no more than they have to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from urdf_walkers import QUADRUPED

from climbplan.arrays import Array
from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.urdf.capsule_fit import fit_capsule, fit_strip_capsules
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.schema.robots.source import load_any_robot

SECTION = """kind: robot
urdf: walker.urdf
legs:
  L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
  R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
  L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
  R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
"""


def walker(folder: Path, more: str = "", text: str = "") -> Robot:
    (folder / "walker.urdf").write_text(text or QUADRUPED.text())
    (folder / "robot.yaml").write_text(SECTION + more)
    return build_robot(load_any_robot("robot.yaml", folder))


def off_axis(points: Array, ends: Array) -> Array:
    """Distances of points (P, 3) from a segment, looked for along it."""
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    axis = ends[0] + share * (ends[1] - ends[0])
    return np.asarray(np.linalg.norm(points - axis, axis=-1).min(axis=0))


def volume(ends: Array, radius: float) -> float:
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return float(np.pi * radius**2 * (length + 4 / 3 * radius))


@pytest.mark.parametrize("half", [(0.3, 0.02, 0.01), (0.1, 0.09, 0.08), (0.05, 0.05, 0.001)])
def test_a_box_has_the_least_capsule_along_its_longest_side(half: tuple[float, ...]) -> None:
    sides = np.array(half)
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    square = float((sides[1:] ** 2).sum())
    long = np.array([half[0], 0.0, 0.0])
    ends, radius = fit_capsule(
        CollisionShape("", corners * sides, 0.0, (np.zeros(3), long, square))
    )
    assert off_axis(corners * sides, ends).max() <= radius + 1e-9
    inner = np.linspace(0.0, half[0], 400)
    others = [
        volume(np.array([-h, 0, 0, h, 0, 0]).reshape(2, 3), np.hypot(half[0] - h, np.sqrt(square)))
        for h in inner
    ]
    assert volume(ends, radius) <= min(others) * (1 + 1e-9)


@pytest.mark.parametrize("flat", ["disc", "plate"])
def test_a_flat_piece_is_held_by_strips_that_reach_little_beyond_it(flat: str) -> None:
    if flat == "disc":
        piece = trimesh.creation.cylinder(radius=0.06, height=0.04, sections=16)
        shape_axis = np.array([0.0, 0.0, 0.02]), 0.06**2
        points = piece.vertices[np.linalg.norm(piece.vertices[:, :2], axis=1) > 0.01]
    else:
        piece = trimesh.creation.box(extents=(0.12, 0.1, 0.03))
        shape_axis = np.array([0.06, 0.0, 0.0]), 0.05**2 + 0.015**2
        points = piece.vertices
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(3).random(3))
    moved = points @ turn[:3, :3].T + 0.3
    axis = np.full(3, 0.3), turn[:3, :3] @ shape_axis[0], shape_axis[1]
    found = fit_strip_capsules(CollisionShape("", moved, 0.0, axis))
    inside = trimesh.sample.sample_surface(piece, 4000, seed=1)[0] @ turn[:3, :3].T + 0.3
    room = [off_axis(inside, ends) - radius for ends, radius in found]
    assert np.min(room, axis=0).max() <= 1e-4  # `off_axis` looks at 2,001 places of the axis
    thin = turn[:3, 2]
    half = np.ptp(points[:, 2]) / 2
    beyond = [np.abs((ends - 0.3) @ thin).max() + radius - half for ends, radius in found]
    assert max(beyond) < 0.01
    assert len(found) in (3, 4)


def test_points_of_a_mesh_lie_within_a_capsule_near_the_least() -> None:
    rng = np.random.default_rng(2)
    body = trimesh.creation.capsule(height=0.3, radius=0.03, count=[12, 12])
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
    points = np.asarray(body.apply_transform(turn).vertices) + rng.random(3)
    ends, radius = fit_capsule(CollisionShape("", points, 0.0))
    assert off_axis(points, ends).max() <= radius + 1e-6
    assert 0.029 < radius < 0.032
    assert 0.27 < np.linalg.norm(ends[1] - ends[0]) < 0.33


def test_capsules_move_with_their_links(tmp_path: Path) -> None:
    robot = walker(tmp_path)
    assert robot.capsules is not None
    angles = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 4, robot.joint_count))
    links, points = limb_capsules(robot, angles), robot.limbs.joint_points(angles)
    # The cylinders of this robot lie about the straight pieces between joints
    first, last = (
        np.take_along_axis(points, robot.capsules.joint[None, ..., None] + end, axis=2)
        for end in (0, 1)
    )
    along = last - first
    for end in (links.starts, links.ends):
        share = ((end - first) * along).sum(-1, keepdims=True) / (along**2).sum(-1, keepdims=True)
        assert np.abs(end - first - share * along).max() < 1e-9
        assert (share > -0.02).all()
        assert (share < 1.02).all()


def test_stated_radii_take_the_place_of_geometry(tmp_path: Path) -> None:
    more = "limb_radii: {L1_knee: 0.05}\n"
    robot = walker(tmp_path, more)
    assert robot.capsules is not None
    own = robot.capsules.joint[0] == 2
    np.testing.assert_allclose(robot.capsules.radius[0][own], 0.05)
    assert (robot.capsules.radius[1:] < 0.03).all()
    assert robot.limb_radius == 0.05
    alike = walker(tmp_path, "limb_radius: 0.03\n")
    assert alike.capsules is None


def test_radii_of_no_joint_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as refused:
        walker(tmp_path, "limb_radii: {L1_kneee: 0.05, L1_knee: -1.0}\n")
    words = str(refused.value)
    assert "limb_radii.L1_knee" in words
    with pytest.raises(SpecError) as refused:
        walker(tmp_path, "limb_radii: {L1_kneee: 0.05}\n")
    assert "limb_radii.L1_kneee" in str(refused.value)
    assert "robot.yaml:8:" in str(refused.value)
