"""The exact search with books that may penetrate each other: only comparisons use it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.exact.pairs import bound_pair_separation, fill_angle_box
from climbplan.bookshelf.scene.generator import generate_scenes
from climbplan.bookshelf.scene.rectangles import compute_half_extents, compute_separation
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf

RIGHT_ANGLE = math.pi / 2

# Books are wider than what they may penetrate each other by.
books = st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(12.0, 40.0), st.floats(50.0, 90.0))
tilts = st.one_of(st.just(0.0), st.just(RIGHT_ANGLE), st.floats(0.1, RIGHT_ANGLE))
depths = st.floats(0.001, 10.0)
shares = st.floats(0.0, 1.0)


def box(low: float, high: float) -> np.ndarray:
    row = np.zeros(7)
    fill_angle_box(low, high, row)
    return row


@settings(max_examples=200, deadline=None)
@given(books, tilts, books, tilts, depths)
def test_least_distance_penetrates_by_the_depth(
    i: tuple[float, float, float],
    a: float,
    j: tuple[float, float, float],
    b: float,
    depth: float,
) -> None:
    apart = bound_pair_separation(*i, box(a, a), *j, box(b, b), 0.0, depth)[0]
    size = np.array([[i[2], i[1]], [j[2], j[1]]])
    angle = np.array([i[0] * a, j[0] * b])
    y = compute_half_extents(angle, size)[:, 1]
    pose = np.stack([[0.0, apart], y, angle], axis=1)
    between = compute_separation(pose[0], size[0], pose[1], size[1])
    assert between == pytest.approx(-depth, abs=1e-6)


@settings(max_examples=400, deadline=None)
@given(
    books,
    st.tuples(tilts, st.sampled_from([1e-3, 0.02, 0.1, 0.5, 2.0])),
    books,
    st.tuples(tilts, st.sampled_from([0.0, 1e-3, 0.02, 0.1, 0.5, 2.0])),
    st.sampled_from([-1.0, 0.0, 1.0]),
    depths,
    st.lists(st.tuples(shares, shares), min_size=1, max_size=8),
)
def test_bounds_hold_everywhere_in_the_boxes(
    i: tuple[float, float, float],
    a: tuple[float, float],
    j: tuple[float, float, float],
    b: tuple[float, float],
    aim: float,
    depth: float,
    points: list[tuple[float, float]],
) -> None:
    (low_i, high_i), (low_j, high_j) = (
        (low, min(low + width, RIGHT_ANGLE)) for low, width in (a, b)
    )
    box_i, box_j = box(low_i, high_i), box(low_j, high_j)
    constant, floor, g, h = bound_pair_separation(*i, box_i, *j, box_j, aim, depth)
    for s, t in [*points, (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]:
        at_i, at_j = low_i + s * (high_i - low_i), low_j + t * (high_j - low_j)
        d_i, d_j = at_i - (low_i + high_i) / 2, at_j - (low_j + high_j) / 2
        least = bound_pair_separation(*i, box(at_i, at_i), *j, box(at_j, at_j), 0.0, depth)[0]
        slack = 1e-9 * (1 + abs(least))
        assert constant <= least + slack
        assert floor + g * d_i + h * d_j <= least + slack


def test_more_depth_never_costs_more_and_is_kept() -> None:
    scenes, shelf = generate_scenes(5, 12, 3), Shelf()
    used = 0
    for scene in scenes:
        before = ExactSolver(shelf).solve(scene)
        for depth in (1e-3, 4e-3):
            answer = ExactSolver(shelf, depth=depth).solve(scene)
            assert answer.status == "optimal"
            assert answer.placement is not None
            assert answer.bound <= before.objective + 1e-9
            placed = answer.placement
            check = check_contact(Scenes.of([scene]), placed.pose[None], placed.state[None], shelf)
            for item in check.items:
                allowed = 1e3 * depth + 0.01 if item.name == "book.overlap" else item.limit
                assert item.residual[0] <= allowed, item.name
            used += bool(answer.objective < before.objective - 1.0)
            before = answer
    assert used > 0
