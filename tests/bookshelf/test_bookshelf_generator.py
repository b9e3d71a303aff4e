"""Dropped scenes: at rest, in order, the same for the same seed."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.scene.generator import (
    DropRules,
    build_drop_shelf,
    generate_scene,
    generate_scenes,
)
from climbplan.bookshelf.scene.rectangles import (
    compute_distance,
    compute_half_extents,
    compute_separation,
)
from climbplan.errors import LimitReached, MissingSolver

needs_pymunk = pytest.mark.skipif(
    importlib.util.find_spec("pymunk") is None, reason="pymunk is not installed"
)


@needs_pymunk
@pytest.mark.parametrize("count", [1, 3, 5])
def test_books_rest_on_the_ground_between_the_walls(count: int) -> None:
    scenes, shelf = generate_scenes(3, 6, count), build_drop_shelf(count)
    assert scenes.pose.shape == (6, count, 3)
    reach = compute_half_extents(scenes.pose[..., 2], scenes.size)
    assert np.abs(scenes.pose[..., 1] - reach[..., 1]).max() < 5e-4
    assert (scenes.pose[..., 0] - reach[..., 0]).min() > shelf.left
    assert (scenes.pose[..., 0] + reach[..., 0]).max() < shelf.right
    assert (np.diff(scenes.pose[..., 0], axis=1) > 0).all()
    rules = DropRules()
    for low, high, sizes in (
        (*rules.height_mm, scenes.sizes[..., 0]),
        (*rules.width_mm, scenes.sizes[..., 1]),
    ):
        assert 1e3 * sizes.min() >= low - 1e-9
        assert 1e3 * sizes.max() <= high + 1e-9
        np.testing.assert_allclose(1e3 * sizes, np.round(1e3 * sizes))


@needs_pymunk
def test_books_keep_their_skins_apart_and_leaning_ones_touch() -> None:
    scenes, shelf = generate_scenes(5, 40, 3), build_drop_shelf(3)
    gaps, leaning = [], 0
    for scene in scenes:
        for k in range(2):
            apart = compute_separation(
                scene.pose[k], scene.size[k], scene.pose[k + 1], scene.size[k + 1]
            )
            assert apart > 3.5e-3
        for k, (_, _, angle) in enumerate(scene.pose):
            steep = shelf.min_lean_angle(scene.size[k])
            other = k - 1 if angle > 0 else k + 1
            if steep < abs(angle) < 1.5 and 0 <= other < 3:
                leaning += 1
                gaps.append(
                    compute_distance(
                        scene.pose[k], scene.size[k], scene.pose[other], scene.size[other]
                    )
                )
    assert leaning > 5
    assert np.median(gaps) < shelf.book_gap


@needs_pymunk
def test_scenes_are_seeded_one_by_one() -> None:
    many = generate_scenes(7, 3, 3)
    alone = generate_scene(7, 2, 3)
    np.testing.assert_array_equal(many.pose[2], alone.pose)
    np.testing.assert_array_equal(many.inserted[2], alone.inserted)
    assert not np.array_equal(many.pose[2], generate_scene(8, 2, 3).pose)
    assert not np.array_equal(many.pose[2], many.pose[1])


@needs_pymunk
def test_dropped_scenes_can_be_solved_and_mostly_need_little() -> None:
    solver = ExactSolver(build_drop_shelf(3))
    costs = np.array([a.objective for a in solver.solve_all(generate_scenes(11, 30, 3))])
    assert np.isfinite(costs).all()
    assert 0.4 < (costs < 1).mean() < 1.0


def test_shelves_grow_with_the_books() -> None:
    shelf = build_drop_shelf(3)
    assert (shelf.left, shelf.right) == pytest.approx((-0.08111, 0.08111))
    assert shelf.published.half_width == pytest.approx(0.088)
    assert build_drop_shelf(7).width > 2 * shelf.width


@needs_pymunk
def test_no_rest_within_the_attempts_is_said() -> None:
    rules = DropRules(seconds=0.05, attempts=3)
    with pytest.raises(LimitReached, match=r"3 books .* 3 drops"):
        generate_scene(0, 0, 3, rules)


def test_without_pymunk_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymunk", None)
    with pytest.raises(MissingSolver, match=r"climbplan\[data\]"):
        generate_scene(0, 0, 3)
