"""The exact bookshelf method: answers pass the exact check, bounds hold, known optima are met."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.exact.method import ExactSolver, SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost
from climbplan.errors import UsageError

SHELF = Shelf()
WIDTH = SHELF.right - SHELF.left


@pytest.fixture(scope="module")
def solver() -> ExactSolver:
    return ExactSolver(SHELF)


def upright(
    centers: list[float], sizes: list[tuple[float, float]], inserted: tuple[float, float]
) -> ShelfScene:
    """Stored books standing at centres [m], sizes (height, width) [m]."""
    size = np.array(sizes)
    pose = np.column_stack([centers, size[:, 0] / 2, np.zeros(len(centers))])
    return ShelfScene(pose, size, np.array(inserted))


def random_upright(seed: int, books: int) -> ShelfScene:
    """Books standing in a row with random gaps; the inserted one often does not fit between."""
    rng = np.random.default_rng(seed)
    widths, heights = rng.uniform(0.01, 0.03, books), rng.uniform(0.05, 0.09, books)
    spare = WIDTH - widths.sum()
    gaps = rng.dirichlet(np.ones(books + 1)) * spare
    left = SHELF.left + np.cumsum(gaps[:-1]) + np.concatenate([[0.0], np.cumsum(widths[:-1])])
    sizes = list(zip(heights, widths, strict=True))
    inserted = (rng.uniform(0.06, 0.09), rng.uniform(0.02, min(0.05, 0.8 * spare)))
    return upright((left + widths / 2).tolist(), sizes, inserted)


def require_sound(scene: ShelfScene, answer: SceneAnswer) -> None:
    """Independent of the search: the checker at 0.01 mm, the cost anew, the bound below it."""
    assert answer.status == "optimal"
    assert answer.placement is not None
    scenes = Scenes.of([scene])
    pose, state = answer.placement.pose[None], answer.placement.state[None]
    check = check_contact(scenes, pose, state, SHELF)
    assert check.passed[0], check.explain(0)
    assert compute_movement_cost(scenes, pose)[0] == pytest.approx(answer.objective, abs=1e-6)
    assert answer.bound <= answer.objective + 1e-9
    assert answer.gap <= max(0.01, 1e-4 * answer.objective) + 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_random_rows_of_books(solver: ExactSolver, seed: int) -> None:
    scene = random_upright(seed, 2 + seed % 3)
    require_sound(scene, solver.solve(scene))


def test_a_book_that_fits_moves_nothing(solver: ExactSolver) -> None:
    scene = upright([-0.06, 0.06], [(0.08, 0.02), (0.08, 0.02)], (0.07, 0.03))
    answer = solver.solve(scene)
    require_sound(scene, answer)
    assert answer.objective <= 0.01


@pytest.mark.parametrize("offset", [0.0, 0.01, -0.02])
def test_one_book_is_pushed_by_what_is_missing(solver: ExactSolver, offset: float) -> None:
    """One book near the middle; the inserted one, too long to lie, needs more than a side."""
    width, inserted = 0.03, 0.1
    scene = upright([offset], [(0.09, width)], (0.105, inserted))
    room = WIDTH / 2 + abs(offset) - width / 2
    missing = 1e3 * (inserted - room)  # [mm]
    assert missing > 1
    answer = solver.solve(scene)
    require_sound(scene, answer)
    assert answer.objective == pytest.approx(missing**2, abs=0.02)


def test_a_larger_inserted_book_never_costs_less(solver: ExactSolver) -> None:
    base = random_upright(5, 4)
    costs = []
    for width in (0.02, 0.03, 0.04):
        scene = ShelfScene(base.pose, base.size, np.array([0.105, width]))
        answer = solver.solve(scene)
        require_sound(scene, answer)
        costs.append(answer.objective)
    assert costs[0] <= costs[1] + 0.02
    assert costs[1] <= costs[2] + 0.02
    assert costs[2] > costs[0]


def test_what_cannot_fit_is_proved_with_the_missing_width(solver: ExactSolver) -> None:
    """Neither book can lie or lean clear of the other: the widths must fit side by side."""
    scene = upright([-0.03], [(0.108, 0.1)], (0.108, 0.09))
    answer = solver.solve(scene)
    assert answer.status == "infeasible"
    assert answer.placement is None
    assert answer.shortage is not None
    missing = 0.19 - WIDTH
    assert answer.shortage.width_bound <= missing + 1e-6
    assert answer.shortage.width <= missing + 1e-4
    assert answer.shortage.width > 0


def test_same_scene_same_answer() -> None:
    scene = random_upright(3, 4)
    first, second = ExactSolver(SHELF).solve(scene), ExactSolver(SHELF).solve(scene)
    assert first.placement is not None
    assert second.placement is not None
    np.testing.assert_array_equal(first.placement.pose, second.placement.pose)
    assert first.bound == second.bound


@pytest.mark.parametrize("bad", [np.nan, 0.0, -0.01, np.inf])
def test_impossible_sizes_are_refused(solver: ExactSolver, bad: float) -> None:
    with pytest.raises(UsageError):
        solver.solve(upright([0.0], [(0.08, bad)], (0.07, 0.03)))


def test_the_checker_sees_overlap_walls_and_floating() -> None:
    scene = upright([-0.02, 0.02], [(0.08, 0.02), (0.08, 0.02)], (0.07, 0.03))
    scenes = Scenes.of([scene])
    state = np.full((1, 3), 2)
    good = np.vstack([scene.pose, [0.06, 0.035, 0.0]])[None]
    assert check_contact(scenes, good, state, SHELF).passed[0]
    for change, name in (
        ([-0.025, 0.0, 0.0], "book.overlap"),
        ([0.02, 0.0, 0.0], "book.wall"),
        ([0.0, 0.001, 0.0], "book.ground"),
        ([0.0, 0.0, 0.1], "book.state"),
    ):
        bad = good.copy()
        bad[0, 2] += change
        check = check_contact(scenes, bad, state, SHELF)
        assert not check.passed[0]
        assert not check[name].passed[0], name


def test_theta_rows_round_trip() -> None:
    scene = random_upright(1, 3)
    scenes = Scenes.of([scene])
    again = Scenes.from_theta(scenes.theta("mm"), "mm")
    np.testing.assert_allclose(again.pose, scenes.pose, atol=1e-12)
    np.testing.assert_allclose(again.inserted, scenes.inserted, atol=1e-12)
    assert scenes.theta("mm").shape == (1, 17)
