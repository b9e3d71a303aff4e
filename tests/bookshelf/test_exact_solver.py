"""Least movement: known optima, limits, proofs that nothing fits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from bookshelf_scenes import PUBLISHED, random_theta
from exact_cases import non_trivial, require_valid

from climbplan.bookshelf.exact import method
from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.exact.search import PAUSED
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf, ShelfScene
from climbplan.errors import UsageError

SHELF = Shelf()


def test_published_scenes() -> None:
    # Costs that the brute-force tests confirm.
    expected = (63.912, 103.52, 147.59, 41.01)
    answers = ExactSolver(SHELF).solve_all(Scenes.from_theta(PUBLISHED, "mm"))
    for answer, cost in zip(answers, expected, strict=True):
        assert answer.status == "optimal"
        assert answer.objective == pytest.approx(cost, abs=0.03)


def _physical(half: float) -> np.ndarray:
    """Three upright books, the shelf full but for the width of one."""
    return np.array([-half + 20, 40, 0, 80, 40, 0, 40, 0, 80, 40, half - 20, 40, 0, 80, 40])


def _solve(
    theta: np.ndarray, shelf: Shelf = SHELF, **limits: float
) -> tuple[ShelfScene, SceneAnswer]:
    scene = Scenes.from_theta(theta[None], "mm")[0]
    return scene, ExactSolver(shelf, ExactLimits(**limits)).solve(scene)  # type: ignore[arg-type]


def test_nothing_moves_where_there_is_room() -> None:
    _, answer = _solve(
        np.array([-60, 40, 0, 80, 20, 0, 40, 0, 80, 20, 60, 40, 0, 80, 20, 80, 20.0])
    )
    assert answer.objective == pytest.approx(0, abs=1e-12)
    assert answer.placement is not None
    assert answer.placement.state.tolist() == [BookState.UPRIGHT] * 4


def test_a_book_slides_no_farther_than_needed() -> None:
    # Room of 41.11 - 1.11 = 40 to the left of book 1, 81.11 - 60 = 21.11 right: 42 needs 2 more.
    theta = np.append(_physical(81.11), [80.0, 42.0])
    scene, answer = _solve(theta)
    gap = 2 * 81.11 - 3 * 40
    assert answer.status == "optimal"
    # Book 1 slides by half the difference from the middle of its free way: all room on one side.
    assert answer.objective == pytest.approx((42 - (gap / 2)) ** 2, abs=0.02)
    require_valid(scene, answer, SHELF)


@pytest.mark.parametrize("width", [42.3, 43.0, 60.0, 200.0])
def test_no_room_is_proved_with_the_missing_width(width: float) -> None:
    theta = np.append(_physical(81.11), [80.0, width])
    if width > 80:
        theta[-2] = 300.0  # nor can it lie
        scene, answer = _solve(theta)
        assert answer.shortage is not None
        assert answer.shortage.height == pytest.approx(1e-3 * (width - 110))
        assert "mm of clear height" in str(answer.shortage)
    else:
        scene, answer = _solve(theta)
        missing = 1e-3 * (3 * 40 + min(width, 80) - 2 * 81.11)
        assert answer.shortage is not None
        assert answer.shortage.width == pytest.approx(missing, abs=1e-9)
        assert 0 < missing - answer.shortage.width_bound <= 2.1e-5
        assert f"{1e3 * missing:.2f} mm of width are missing" in str(answer.shortage)
        wider = Shelf(left=SHELF.left, right=SHELF.right + answer.shortage.width + 1e-6)
        assert ExactSolver(wider).solve(scene).placement is not None
    assert answer.status == "infeasible"
    assert answer.placement is None
    assert answer.objective == answer.bound == math.inf


def test_leaning_can_save_what_standing_cannot() -> None:
    # Books too tall to stand: they must lean or lie, and lying is too long.
    shelf = Shelf(left=-0.08, right=0.08, height=0.100)
    theta = np.array([-40, 40, 0.6, 115, 15, 40, 40, -0.6, 115, 15, 60.0, 20.0])
    scene, answer = _solve(theta, shelf)
    assert answer.placement is not None
    assert set(answer.placement.state[:2].tolist()) <= {
        BookState.LEAN_LEFT,
        BookState.LEAN_RIGHT,
        BookState.FLAT_LEFT,
        BookState.FLAT_RIGHT,
    }
    require_valid(scene, answer, shelf)


def test_limits_keep_the_incumbent_and_a_valid_bound() -> None:
    hard = max(non_trivial(3, 30, seed=8), key=lambda case: case.answer.nodes)
    theta, scene, answer = hard.theta, hard.scene, hard.answer
    assert answer.nodes > 200
    _, stopped = _solve(theta, nodes=1)
    assert stopped.nodes < answer.nodes
    assert stopped.status == "feasible"
    require_valid(scene, stopped, SHELF)
    assert stopped.bound <= answer.objective + 1e-9
    assert stopped.gap > 0.01


def test_a_tighter_gap_is_kept() -> None:
    _, answer = _solve(PUBLISHED[2], gap_absolute=1e-5, gap_relative=0.0)
    assert answer.status == "optimal"
    assert answer.gap <= 1e-5 * (1 + 1e-6)


def test_books_that_overlap_at_the_start_are_parted() -> None:
    theta = np.array([0, 40, 0, 80, 20, 5, 40, 0, 80, 20, 8, 40, 0, 80, 20, 80, 20.0])
    scene, answer = _solve(theta)
    require_valid(scene, answer, SHELF)
    # Centres 20 apart about their mean: the least squares of a rigid row.
    row = np.array([-20, 0, 20]) + (0 + 5 + 8) / 3
    assert answer.objective == pytest.approx(((row - [0, 5, 8]) ** 2).sum(), abs=0.02)


def test_odd_scenes_have_answers() -> None:
    rows = {
        "floating": [-60, 400, 0.3, 80, 20, 0, 40, 0, 80, 20, 60, 300, 0, 80, 20, 80, 20],
        "far away": [5000, 40, 0, 80, 20, -9000, 40, 0, 80, 20, 8, 40, 0, 80, 20, 80, 20],
        "wrong order": [50, 40, 0, 80, 20, 0, 40, 0, 80, 20, -50, 40, 0, 80, 20, 80, 20],
        "upside down": [-50, 40, 3.14, 80, 20, 0, 40, -3.1, 80, 20, 50, 10, 4.71, 80, 20, 80, 20],
        "square": [-50, 15, 0.7, 30, 30, 0, 15, 0, 30, 30, 50, 15, 1.5, 30, 30, 30, 30],
        "wide and low": [-50, 15, 0.7, 10, 60, 0, 15, 0, 30, 30, 50, 15, 1.5, 30, 30, 30, 30],
        "thin": [-50, 40, 0.3, 80, 0.01, 0, 40, 0.2, 80, 0.01, 50, 40, -0.2, 80, 0.01, 80, 0.01],
        "one book": [0, 40, 0, 80, 40, 80, 40],
    }
    for name, row in rows.items():
        scene, answer = _solve(np.array(row, float))
        assert answer.status == "optimal", name
        require_valid(scene, answer, SHELF)


def test_a_stored_book_that_fits_nowhere() -> None:
    theta = np.array([0, 40, 0, 200, 190, 80, 20.0])  # neither stands nor lies below the lid
    _, answer = _solve(theta)
    assert answer.status == "infeasible"
    assert answer.shortage is not None
    assert answer.shortage.height == pytest.approx(0.080)


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -10.0])
def test_no_books_no_answer(value: float) -> None:
    scene = Scenes.from_theta(PUBLISHED, "mm")[0]
    size = scene.size.copy()
    size[1, 1] = value
    with pytest.raises(UsageError, match="book 1: width"):
        ExactSolver(SHELF).solve(ShelfScene(scene.pose, size, scene.inserted))


def test_five_books() -> None:
    rng = np.random.default_rng(12)
    shelf = Shelf(left=-0.12511, right=0.12511)
    solver = ExactSolver(shelf)
    for _ in range(5):
        theta = random_theta(rng, 5, 125.11)
        scene = Scenes.from_theta(theta[None], "mm")[0]
        answer = solver.solve(scene)
        assert answer.status == "optimal"
        require_valid(scene, answer, shelf)


def test_one_solver_solves_shelves_of_all_sizes_again_and_again() -> None:
    solver, rng = ExactSolver(SHELF), np.random.default_rng(2)
    scenes = [
        Scenes.from_theta(random_theta(rng, n, 81.11)[None], "mm")[0] for n in (1, 3, 2, 3, 1)
    ]
    first = [solver.solve(scene).objective for scene in scenes]
    again = [solver.solve(scene).objective for scene in reversed(scenes)]
    assert first == again[::-1]


def test_the_clock_is_looked_at_between_nodes_that_take_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nodes of 0.05 s by a clock of the test's own: the search ends two nodes late at most."""
    now, step = [0.0], 0.05

    def slow(*arguments: Any) -> int:
        now[0] += step * arguments[-1]
        return PAUSED

    monkeypatch.setattr(method, "expand_nodes", slow)
    monkeypatch.setattr(method.time, "perf_counter", lambda: now[0])
    solver = ExactSolver(SHELF, ExactLimits(time=1.0))
    tree, finished = solver._search(method.build_problem(_many(60), SHELF), 0.01, 1e-4, 1.0)
    assert not finished
    assert 1.0 < now[0] <= 1.0 + 2 * step
    assert (
        tree.counters[method.UNUSED] < len(tree.pool) - 2 * 61
    )  # placements side by side are in it


def test_a_tree_has_room_for_placements_of_many_books(monkeypatch: pytest.MonkeyPatch) -> None:
    books = 8
    monkeypatch.setattr(method, "_CAPACITY", 4)  # fewer than there are roots
    monkeypatch.setattr(method, "expand_nodes", lambda *arguments: PAUSED)
    solver = ExactSolver(SHELF, ExactLimits(time=0.0))
    tree, _ = solver._search(method.build_problem(_many(books), SHELF), 0.01, 1e-4, 0.0)
    assert 0 <= tree.counters[method.UNUSED] <= len(tree.pool) - 2 * (books + 1)


def _many(count: int) -> ShelfScene:
    """Thin books side by side."""
    width = 0.002
    centre = SHELF.left + width * (np.arange(count) + 0.5)
    pose = np.column_stack([centre, np.full(count, 0.03), np.zeros(count)])
    return ShelfScene(pose, np.tile([0.06, width], (count, 1)), np.array([0.06, width]))
