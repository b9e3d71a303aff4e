"""Scenes at the edge of what a shelf is asked for: an optimum, or the proof of none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact_cases import require_valid, upright

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf, ShelfScene
from climbplan.errors import UsageError

SHELF = Shelf()


def _optimum(scene: ShelfScene, shelf: Shelf = SHELF) -> SceneAnswer:
    answer = ExactSolver(shelf).solve(scene)
    assert answer.status == "optimal"
    require_valid(scene, answer, shelf)
    return answer


def _proved_missing(scene: ShelfScene, shelf: Shelf = SHELF) -> float:
    """Missing width [mm] of a scene without a placement."""
    answer = ExactSolver(shelf).solve(scene)
    assert answer.status == "infeasible"
    assert answer.placement is None
    assert answer.objective == answer.bound == math.inf
    assert answer.shortage is not None
    assert answer.shortage.height == 0
    assert 0 <= answer.shortage.width - answer.shortage.width_bound <= 2.1e-5
    return 1e3 * answer.shortage.width


@pytest.mark.parametrize("seed", range(6))
def test_a_shelf_exactly_as_wide_as_the_books(seed: int) -> None:
    widths = np.random.default_rng(seed).uniform(10, 40, 4)
    half = 5e-4 * float(widths.sum())
    sizes = [(100.0, float(w)) for w in widths]
    scene = upright([-30.0, 0.0, 30.0], sizes[:3], sizes[3])
    answer = _optimum(scene, Shelf(left=-half, right=half))
    assert answer.placement is not None
    assert (answer.placement.state == BookState.UPRIGHT).all()
    costs = []
    for slot in range(4):  # the books in their order, packed, with the inserted one at the slot
        packed = np.insert(widths[:3], slot, widths[3])
        centres = np.cumsum(packed) - packed / 2 - 1e3 * half
        costs.append(float(((np.delete(centres, slot) - [-30, 0, 30]) ** 2).sum()))
    assert answer.objective == pytest.approx(min(costs), abs=1e-6)


@pytest.mark.parametrize("over", [1e-4, 0.03, 2.0])
def test_a_shelf_a_little_too_narrow(over: float) -> None:
    scene = upright([-40.0, 0.0, 40.0], [(105.0, 40.0)] * 3, (105.0, 42.22 + over))
    assert _proved_missing(scene) == pytest.approx(over, abs=1e-6)


def test_a_stored_book_wider_than_the_shelf() -> None:
    # It lies no shorter than it stands; 170 + 10 on 162.22.
    assert _proved_missing(upright([0], [(100, 170)], (50, 10))) == pytest.approx(17.78)


def test_an_inserted_book_wider_than_the_shelf() -> None:
    scene = upright([0], [(80, 20)], (300, 105))
    # 105 standing is too wide for none, but 300 is too high; lying takes 300.
    assert _proved_missing(scene) == pytest.approx(300 + 20 - 162.22)


def test_neither_standing_nor_lying_there_is_no_height() -> None:
    answer = ExactSolver(SHELF).solve(upright([0], [(170, 150)], (80, 20)))
    assert answer.status == "infeasible"
    assert answer.shortage is not None
    assert answer.shortage.height == pytest.approx(0.04)
    assert answer.shortage.width == answer.shortage.width_bound == 0
    assert str(answer.shortage) == "a book misses 40.00 mm of clear height"


def test_books_that_stick_out_of_the_shelf_are_pushed_in() -> None:
    answer = _optimum(upright([-90, 0, 95], [(100, 30)] * 3, (100, 20)))
    # To 15 off the walls at 81.11, while 102.22 - 30 remain for 20.
    expected = (90 - 66.11) ** 2 + (95 - 66.11) ** 2
    assert answer.objective == pytest.approx(expected, abs=0.2)


def test_floating_books_come_down() -> None:
    scene = upright([-50, 50], [(80, 30)] * 2, (80, 20))
    pose = scene.pose + np.array([[0, 0.004, 0], [0, 0.003, 0]])
    floating = ShelfScene(pose, scene.size, scene.inserted)
    down = 4.0**2 + 3.0**2
    answer = _optimum(floating, Shelf(lean_margin=math.pi / 2))  # no leaning
    assert answer.objective == pytest.approx(down, abs=0.01)
    assert _optimum(floating).objective < down - 1  # leaning lifts the centre


def test_a_tall_book_fits_only_flat() -> None:
    shelf = Shelf(left=-0.15, right=0.15)
    answer = _optimum(upright([-60, 60], [(105, 30)] * 2, (150, 20)), shelf)
    assert answer.placement is not None
    assert answer.placement.state[-1] == BookState.FLAT_LEFT
    # 150 between the two takes 120 + 30 - 120 + 30 = 60 away from 90 of room: each gives 30.
    assert answer.objective == pytest.approx(2 * 30.0**2, abs=0.2)
    scene = upright([-60, 60], [(105, 30)] * 2, (150, 20))
    assert _proved_missing(scene) == pytest.approx(210 - 162.22)


def test_a_stored_book_that_was_stored_flat_as_it_is_too_tall() -> None:
    scene = ShelfScene(
        np.array([[0.0, 0.01, math.pi / 2]]), np.array([[0.15, 0.02]]), np.array([0.1, 0.1])
    )
    answer = _optimum(scene, Shelf(left=-0.125, right=0.125))
    assert answer.objective == pytest.approx(50.0**2, rel=1e-4)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_identical_books_at_one_place_are_parted(count: int) -> None:
    shelf = Shelf(left=-0.2, right=0.2)
    answer = _optimum(upright([0.0] * count, [(100, 20)] * count, (100, 20)), shelf)
    row = 20.0 * (np.arange(count) - (count - 1) / 2)
    assert answer.objective == pytest.approx(float((row**2).sum()), rel=1e-4, abs=0.01)


def test_sheets_of_a_millimetre() -> None:
    pose = np.array([[-0.04, 0.03, 0.5], [0.0, 0.02, -0.9], [0.04, 0.02, 1.2]])
    _optimum(ShelfScene(pose, np.array([[0.08, 0.001]] * 3), np.array([0.08, 0.1])))
    assert _optimum(upright([-40, 0, 40], [(80, 1)] * 3, (80, 1))).objective == 0


def test_a_shelf_of_two_metres() -> None:
    shelf = Shelf(left=-1.0, right=1.0, height=1.6)
    assert _optimum(upright([-500, 0, 500], [(80, 30)] * 3, (80, 30)), shelf).objective == 0
    centres = np.linspace(-900, 900, 5).tolist()
    answer = _optimum(upright(centres, [(1500, 300)] * 5, (1500, 300)), shelf)
    # Six of 300 leave 200: four of the packed row of six are free to stay or share the rest.
    assert answer.objective > 1


def test_a_shelf_narrower_than_any_book() -> None:
    scene = upright([0], [(80, 30)], (80, 30))
    assert _proved_missing(scene, Shelf(left=-0.001, right=0.001)) == pytest.approx(58.0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e6])
@pytest.mark.parametrize("column", range(3))
def test_no_place_no_answer(value: float, column: int) -> None:
    scene = upright([0], [(80, 30)], (80, 30))
    pose = scene.pose.copy()
    pose[0, column] = value
    with pytest.raises(UsageError, match="book 0: "):
        ExactSolver(SHELF).solve(ShelfScene(pose, scene.size, scene.inserted))


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -0.01])
@pytest.mark.parametrize("column", range(2))
def test_no_inserted_book_no_answer(value: float, column: int) -> None:
    scene = upright([0], [(80, 30)], (80, 30))
    inserted = scene.inserted.copy()
    inserted[column] = value
    with pytest.raises(UsageError, match="inserted: "):
        ExactSolver(SHELF).solve(ShelfScene(scene.pose, scene.size, inserted))


# Rows of generated and random scenes whose searches did not end: intervals were halved that were
# points already, or those whose turn cost the bound did not count were never halved.
# fmt: off
_FREE_TURN = [
    -90.0282432, 40.4990478, 0.650214909, 83, 25, -40.6772636, 41.4476361, 0.00457820493, 83, 21,
    7.21469669, 36.5612978, -0.649028892, 67, 33, 49.9313858, 41.5231513, -0.00650161593, 83, 11,
    66.9423137, 44.4479176, -0.0063639178, 89, 15, 72, 14,
]
_STEEP_FACE = [
    -92.018, 20.475, 0.303, 41.495, 4.512, -91.425, 2.325, 1.571, 99.732, 4.65,
    -55.377, 0.571, 1.571, 33.239, 1.143, 70.217, 1.08, 1.571, 125.587, 2.159, 72.28, 1.4,
]
# fmt: on


@pytest.mark.parametrize(
    ("row", "shelf"),
    [
        (_FREE_TURN, Shelf(left=-0.12511, right=0.12511)),
        (
            _STEEP_FACE,
            Shelf(left=-0.10311, right=0.10311, book_gap=0.0005, lean_margin=0.05),
        ),
    ],
)
def test_searches_that_once_did_not_end(row: list[float], shelf: Shelf) -> None:
    scene = Scenes.from_theta(np.array([row]), "mm")[0]
    answer = ExactSolver(shelf, ExactLimits(time=60.0, nodes=40_000)).solve(scene)
    assert answer.status == "optimal"
    require_valid(scene, answer, shelf)
