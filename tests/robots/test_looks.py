"""Looks of a robot follow its joints, and large meshes become coarser without moving."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from matplotlib.collections import PolyCollection
from walking_urdf import walking_robot

from climbplan.reports.robot_picture import draw_robot_picture
from climbplan.robots.any_robot import build_robot
from climbplan.robots.facts import measure_robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.visuals import index_submeshes, simplify_mesh
from climbplan.robots.visual_geometry import (
    BODY,
    VisualGeometry,
    compute_piece_poses,
    split_by_link,
)


def test_a_vertex_at_the_toe_goes_where_the_toe_goes() -> None:
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(2, 3, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    names = (("a", "b", "c"), ("d", "e", "f"))
    toe = rng.normal(size=(2, 3))
    chain = SerialChain(names, rng.normal(size=(2, 3, 3)), axes, toe, np.zeros((2, 3)))
    vertices = np.concatenate([np.tile(toe[1], (3, 1)), np.eye(3)])
    limb, joint = np.repeat([1, BODY], 3), np.repeat([2, 0], 3)
    looks = VisualGeometry(vertices, np.array([[0, 1, 2], [3, 4, 5]]), limb, joint)
    pieces = split_by_link(looks, chain)
    angles = rng.uniform(-2, 2, size=(5, 2, 3))
    place, turned = compute_piece_poses(pieces, chain, angles)
    assert [piece.limb for piece in pieces] == [BODY, 1]
    at = place[:, 1] + turned[:, 1] @ pieces[1].vertices[0]
    assert np.abs(at - chain.joint_points(angles)[:, 1, -1]).max() < 1e-12
    assert np.abs(place[:, 0]).max() == 0
    assert np.array_equal(pieces[0].vertices, np.eye(3))


def test_large_meshes_become_coarser_and_keep_their_size() -> None:
    ball = trimesh.creation.icosphere(5, 0.1)
    vertices, faces = simplify_mesh(np.array(ball.vertices), np.array(ball.faces), 1500)
    assert 300 < len(faces) <= 1500
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.1).max() < 0.005
    small = trimesh.creation.box((1.0, 1.0, 1.0))
    kept, same = simplify_mesh(np.array(small.vertices), np.array(small.faces), 1500)
    assert np.array_equal(kept, small.vertices)
    assert np.array_equal(same, small.faces)


def test_submeshes_have_vertices_of_their_own() -> None:
    """Submeshes counted from zero are told apart; other meshes are left as they are."""
    first, second = [[0, 1, 2], [2, 1, 3]], [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
    faces = index_submeshes(np.array(first + second), 9)
    assert np.array_equal(faces[:2], first)
    assert np.array_equal(faces[2:], np.array(second) + 4)
    for other, count in ((first, 4), (first + second, 10), (second[1:], 5)):
        assert np.array_equal(index_submeshes(np.array(other), count), other)


def test_a_picture_shows_triangles_at_their_links(tmp_path: Path) -> None:
    """A box about a toe's link, where the posture has that link."""
    robot = build_robot(walking_robot(tmp_path))
    facts = measure_robot(robot)
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    vertices = np.array(box.vertices) + chain.toe_zero[1]
    here = np.ones(len(vertices), np.int64)
    looks = VisualGeometry(vertices, np.array(box.faces, np.int64), here, 2 * here)
    figure = draw_robot_picture(facts, geometry=looks)
    toe = robot.stance_body[1]
    for ax, (across, up) in zip(figure.axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        (drawn,) = (one for one in ax.collections if isinstance(one, PolyCollection))
        middle = np.concatenate([p.vertices for p in drawn.get_paths()]).mean(axis=0)
        assert np.abs(middle - toe[[across, up]]).max() < 0.015
