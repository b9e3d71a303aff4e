"""Terrain patches: clipping, faces of solids, tubes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.climb.pages.patches import (
    MARGIN,
    TUBE_SIDES,
    AxisAlignedBox,
    clip,
    compute_climb_box,
    compute_hull_points,
    list_solid_faces,
    list_surface_patches,
)
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.camera import FRONT, SIDE, OrthographicCamera, choose_clear_view
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Tube

UNIT = AxisAlignedBox(np.zeros(3), np.ones(3))


def area(polygon: np.ndarray) -> float:
    fan = np.cross(polygon[1:-1] - polygon[0], polygon[2:] - polygon[0])
    return float(np.linalg.norm(fan.sum(axis=0)) / 2)


@pytest.mark.parametrize(
    ("square", "expected"),
    [
        ([[-1, -1, 0.5], [2, -1, 0.5], [2, 2, 0.5], [-1, 2, 0.5]], 1.0),  # covers the box
        ([[0.2, 0.2, 0.5], [0.6, 0.2, 0.5], [0.6, 0.6, 0.5], [0.2, 0.6, 0.5]], 0.16),  # inside
        ([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [1.5, 1.5, 0.5], [0.5, 1.5, 0.5]], 0.25),  # a corner
        ([[2, 2, 0.5], [3, 2, 0.5], [3, 3, 0.5], [2, 3, 0.5]], 0.0),  # beyond it
        ([[-1, 0.5, -1], [2, 0.5, -1], [2, 0.5, 2], [-1, 0.5, 2]], 1.0),  # upright
    ],
)
def test_clip_keeps_the_part_inside(square: list[list[float]], expected: float) -> None:
    inside = clip(np.array(square, float), UNIT.solid())
    assert (area(inside) if len(inside) else 0.0) == pytest.approx(expected)
    assert (inside >= -1e-12).all()
    assert (inside <= 1 + 1e-12).all()


def test_faces_of_a_solid_close_it() -> None:
    wide = AxisAlignedBox(np.full(3, -9.0), np.full(3, 9.0))
    box = Solid.from_box("box", np.array([-1.0, -2.0, -3.0]), np.array([1.0, 2.0, 3.0]))
    faces = list_solid_faces(box, wide)
    assert len(faces) == 6
    assert sum(area(face.vertices) for face in faces) == pytest.approx(2 * (8 + 12 + 24))
    wedge = Solid.from_points("wedge", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    assert sorted(len(face.vertices) for face in list_solid_faces(wedge, wide)) == [3, 3, 3, 3]
    assert list_solid_faces(box, AxisAlignedBox(np.full(3, 20.0), np.full(3, 30.0))) == []
    assert list_solid_faces(box, AxisAlignedBox(np.full(3, -0.5), np.full(3, 0.5))) == []


def test_a_cut_solid_is_closed_again() -> None:
    box = Solid.from_box("box", np.array([-1.0, -2.0, -3.0]), np.array([1.0, 2.0, 3.0]))
    half = list_solid_faces(box, AxisAlignedBox(np.full(3, -9.0), np.array([9.0, 9.0, 0.0])))
    assert sum(area(face.vertices) for face in half) == pytest.approx(2 * (8 + 6 + 12))
    # The outward area of a closed surface is zero.
    total = sum(area(face.vertices) * face.normal for face in half)
    assert np.allclose(total, 0.0)


def test_tube_strips_face_the_axis_and_end_at_the_box() -> None:
    tube = Tube("tube", np.array([0.1, 0.2]), 0.6, -1.0, 5.0, 1.0)
    strips = list_surface_patches(tube, AxisAlignedBox(np.full(3, -2.0), np.array([2.0, 2.0, 1.5])))
    assert len(strips) == TUBE_SIDES
    for strip in strips:
        assert np.allclose(np.linalg.norm(strip.vertices[:, :2] - tube.center, axis=1), 0.6)
        assert set(strip.vertices[:, 2]) == {-1.0, 1.5}
        middle = strip.vertices.mean(axis=0)
        assert strip.normal @ np.append(tube.center - middle[:2], 0.0) > 0
    assert list_surface_patches(tube, AxisAlignedBox(np.full(3, 6.0), np.full(3, 7.0))) == []


def test_the_box_holds_the_whole_climb(make_plan: Callable[..., ClimbPlan]) -> None:
    plan = make_plan(6, 3)
    box = compute_climb_box(plan)
    hull = compute_hull_points(plan, plan.rounds.com, plan.rounds.rpy)
    for points in (hull, plan.rounds.toes, plan.instants.toes):
        assert (points >= box.lower + MARGIN - 1e-9).all()
        assert (points <= box.upper - MARGIN + 1e-9).all()


def test_views_along_an_axis_keep_coordinates() -> None:
    point = np.array([0.3, -0.7, 1.1])
    assert np.allclose(FRONT.project(point), [0.3, 1.1])
    assert np.allclose(SIDE.project(point), [-0.7, 1.1])
    axes = OrthographicCamera(-63.0, 18.0).axes
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_the_view_is_from_the_side_that_obstacles_leave_open() -> None:
    path = np.array([[0.0, 0.3, 0.0], [0.0, 0.3, 0.8]])
    ahead = np.array([0.0, 0.6, 0.0])
    nearer, farther = path - ahead, path + ahead
    assert choose_clear_view(-60.0, 20.0, path, farther) == OrthographicCamera(-60.0, 20.0)
    assert choose_clear_view(-60.0, 20.0, path, nearer) == OrthographicCamera(60.0, 20.0)
    assert choose_clear_view(-60.0, 20.0, path, np.empty((0, 3))) == OrthographicCamera(-60.0, 20.0)
