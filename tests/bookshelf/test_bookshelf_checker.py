"""Every constraint of both meanings, broken one at a time by a known amount."""

from __future__ import annotations

import math

import numpy as np
import pytest

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.check.checks import PlacementCheck
from climbplan.bookshelf.check.published import check_published, infer_published_states
from climbplan.bookshelf.scene.rectangles import find_slots
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf, ShelfScene

SHELF = Shelf()
TILT = 0.5
CONTACT = {
    "book.overlap",
    "book.wall",
    "book.ground",
    "book.clear_height",
    "book.state",
    "book.stability",
    "book.support",
    "book.order",
}


def _height(angle: float, h: float, w: float) -> float:
    return (w * abs(math.sin(angle)) + h * math.cos(angle)) / 2


def _good() -> tuple[Scenes, np.ndarray, np.ndarray]:
    """Book 0 leans on the left wall, book 1 is upright, book 2 flat, the inserted one upright."""
    size = np.array([[0.08, 0.02], [0.07, 0.02], [0.055, 0.02]])
    inserted = np.array([0.07, 0.02])
    reach = (0.02 * math.cos(TILT) + 0.08 * math.sin(TILT)) / 2
    pose = np.array(
        [
            [SHELF.left + reach + 0.001, _height(TILT, 0.08, 0.02), TILT],
            [-0.008, 0.035, 0.0],
            [0.022 + 0.0275, 0.010, -math.pi / 2],
            [0.012, 0.035, 0.0],
        ]
    )
    state = np.array(
        [BookState.LEAN_LEFT, BookState.UPRIGHT, BookState.FLAT_RIGHT, BookState.UPRIGHT], np.int64
    )
    scenes = Scenes.of([ShelfScene(pose[:3], size, inserted)])
    return scenes, pose[None], state[None]


def _broken(check: PlacementCheck) -> dict[str, float]:
    return {i.name: float(i.residual[0]) for i in check.items if not i.passed[0]}


def test_a_good_placement_passes() -> None:
    scenes, pose, state = _good()
    check = check_contact(scenes, pose, state, SHELF)
    assert {item.name for item in check.items} == CONTACT
    assert check.passed.all(), check.explain(0)
    assert check.explain(0) == ""
    assert find_slots(pose, scenes.sizes) == [2]


def test_overlap_is_measured_and_placed() -> None:
    scenes, pose, state = _good()
    pose[0, 3, 0] += 0.5e-3  # into book 2
    check = check_contact(scenes, pose, state, SHELF)
    assert _broken(check) == {"book.overlap": pytest.approx(0.5)}
    assert check["book.overlap"].place[0] == "book 2 and the inserted book"
    assert "book.overlap: 0.5 mm at book 2 and the inserted book" in check.explain(0)


def test_walls_and_clear_height() -> None:
    scenes, pose, state = _good()
    pose[0, 0, 0] -= 1.2e-3
    check = check_contact(scenes, pose, state, SHELF)
    assert _broken(check) == {"book.wall": pytest.approx(0.2)}
    low = Shelf(height=0.069)
    scenes, pose, state = _good()
    broken = _broken(check_contact(scenes, pose, state, low))
    assert broken["book.clear_height"] == pytest.approx(1e3 * (2 * pose[0, 0, 1] - 0.069))


def test_ground() -> None:
    for lift in (2e-4, -2e-4):
        scenes, pose, state = _good()
        pose[0, 1, 1] += lift
        assert _broken(check_contact(scenes, pose, state, SHELF)) == {
            "book.ground": pytest.approx(0.2)
        }


def test_state_must_fit_the_angle() -> None:
    scenes, pose, state = _good()
    state[0, 1] = BookState.FLAT_LEFT
    broken = _broken(check_contact(scenes, pose, state, SHELF))
    assert broken == {"book.state": pytest.approx(math.pi / 2)}
    scenes, pose, state = _good()
    state[0, 0] = BookState.LEAN_RIGHT  # tilted to the left
    broken = _broken(check_contact(scenes, pose, state, SHELF))
    assert broken["book.state"] == pytest.approx(TILT)
    assert "book.support" in broken  # and nothing near to lean on
    scenes, pose, state = _good()
    state[0, 2] = 7  # no state at all
    assert _broken(check_contact(scenes, pose, state, SHELF)) == {"book.state": math.inf}


def test_upside_down_is_no_state() -> None:
    scenes, pose, state = _good()
    pose[0, 1, 2] = math.pi
    assert _broken(check_contact(scenes, pose, state, SHELF))["book.state"] == pytest.approx(
        math.pi
    )


def test_the_inserted_book_must_not_lean() -> None:
    scenes, pose, state = _good()
    state[0, 3] = BookState.LEAN_LEFT
    assert _broken(check_contact(scenes, pose, state, SHELF))["book.state"] == math.inf


def test_a_book_that_leans_too_little_falls_back() -> None:
    scenes, pose, state = _good()
    least = math.atan2(0.02, 0.08)
    pose[0, 0, 2] = least - 0.01
    pose[0, 0, 1] = _height(least - 0.01, 0.08, 0.02)
    pose[0, 0, 0] = SHELF.left + 0.0195
    assert _broken(check_contact(scenes, pose, state, SHELF)) == {
        "book.stability": pytest.approx(0.01)
    }


def test_support_by_wall_and_by_neighbour() -> None:
    scenes, pose, state = _good()
    pose[0, 0, 0] += 1e-3  # 2 mm from the wall where 1.5 are allowed
    assert _broken(check_contact(scenes, pose, state, SHELF)) == {
        "book.support": pytest.approx(0.5)
    }
    # Book 1 leans on book 0, made upright, from 5 mm away.
    scenes, pose, state = _good()
    pose[0, 0] = [SHELF.left + 0.010, 0.040, 0.0]
    state[0, 0] = BookState.UPRIGHT
    angle = 0.6
    # Top left corner of book 1, below the top of book 0.
    reach = (0.02 * math.cos(angle) + 0.07 * math.sin(angle)) / 2
    pose[0, 1] = [SHELF.left + 0.020 + 0.005 + reach, _height(angle, 0.07, 0.02), angle]
    state[0, 1] = BookState.LEAN_LEFT
    assert _broken(check_contact(scenes, pose, state, SHELF)) == {
        "book.support": pytest.approx(0.9)
    }


def test_the_inserted_book_is_no_support() -> None:
    scenes, pose, state = _good()
    # The inserted book between wall and book 0, which leans on it but not on the wall.
    reach = (0.02 * math.cos(TILT) + 0.08 * math.sin(TILT)) / 2
    pose[0, 3, 0] = SHELF.left + 0.010
    pose[0, 0, 0] = SHELF.left + 0.020 + reach
    pose[0, 1, 0] = pose[0, 0, 0] + reach + 0.010
    pose[0, 2, 0] = pose[0, 1, 0] + 0.010 + 0.0275
    check = check_contact(scenes, pose, state, SHELF)
    assert _broken(check) == {"book.support": pytest.approx(20 - 1.5)}
    assert find_slots(pose, scenes.sizes) == [0]


def test_stored_order_is_kept() -> None:
    scenes, pose, state = _good()
    pose[0, 2, 0], pose[0, 1, 0] = 0.010, 0.050  # book 2 left of book 1
    pose[0, 3, 0] = 0.070
    broken = _broken(check_contact(scenes, pose, state, SHELF))
    assert broken == {"book.order": pytest.approx(40.0)}


@pytest.mark.parametrize("entry", [(0, 0, 0), (0, 1, 1), (0, 2, 2), (0, 3, 0), (0, 3, 2)])
def test_nan_never_passes(entry: tuple[int, int, int]) -> None:
    scenes, pose, state = _good()
    pose[entry] = math.nan
    check = check_contact(scenes, pose, state, SHELF)
    assert not check.passed[0]
    assert check.worst(0).severity[0] == math.inf
    assert not check_published(scenes, pose, state, SHELF).passed[0]


def test_scenes_are_checked_side_by_side() -> None:
    scenes, pose, state = _good()
    many = Scenes.of([scenes[0]] * 3)
    poses, states = np.repeat(pose, 3, axis=0), np.repeat(state, 3, axis=0)
    poses[1, 1, 1] += 1e-3
    check = check_contact(many, poses, states, SHELF)
    assert check.passed.tolist() == [True, False, True]
    assert check["book.ground"].place[1] == "book 1"


def test_published_tolerances_are_looser_on_a_wider_frame() -> None:
    scenes, pose, state = _good()
    pose[0, 0, 0] += 2e-3  # 3 mm from where books come to rest, 10 mm from the frame
    assert check_published(scenes, pose, state, SHELF)["book.support"].residual[0] == pytest.approx(
        3 - 0.11
    )
    pose[0, 0, 0] -= 2e-3
    check = check_published(scenes, pose, state, SHELF)
    assert check.passed.all(), check.explain(0)
    pose[0, 3, 0] += 2.8e-3  # a line may cut 1.5 mm into both books
    assert check_published(scenes, pose, state, SHELF).passed.all()
    pose[0, 3, 0] += 0.4e-3
    assert _broken(check_published(scenes, pose, state, SHELF)) == {
        "book.separation": pytest.approx(1.6)
    }


def test_published_line_passes_named_corners() -> None:
    # Two books whose facing sides are parallel: the line through both corners separates them.
    size = np.array([[0.06, 0.02], [0.06, 0.02]])
    angle = 0.5
    y = _height(angle, 0.06, 0.02)
    first = np.array([-0.03, y, angle])
    apart = 0.02 / math.cos(angle)
    second = first + np.array([apart + 0.004 / math.cos(angle), 0, 0])
    inserted = np.array([0.05, 0.03, 0.0])
    scenes = Scenes.of([ShelfScene(np.stack([first, second]), size, np.array([0.06, 0.02]))])
    pose = np.stack([first, second, inserted])[None]
    state = infer_published_states(scenes, pose, SHELF)
    assert state.tolist() == [[BookState.LEAN_LEFT, BookState.LEAN_LEFT, BookState.UPRIGHT]]
    check = check_published(scenes, pose, state, SHELF)
    # Sides 4 mm apart: the best line turns a little to come near both corners.
    assert check["book.stability"].passed[0]
    sampled = _sampled_line(pose[0], size)
    assert sampled < 2.0
    wall = 1e3 * (first[0] - (0.02 * math.cos(angle) + 0.06 * math.sin(angle)) / 2 + 0.088 - 0.007)
    assert check["book.support"].residual[0] == pytest.approx(max(sampled, wall), abs=1e-3)


def _sampled_line(pose: np.ndarray, size: np.ndarray) -> float:
    """Least tolerance over sampled directions of the line [mm]."""
    from climbplan.bookshelf.scene.rectangles import compute_corners

    left, right = 1e3 * compute_corners(pose[0], size[0]), 1e3 * compute_corners(pose[1], size[1])
    best = math.inf
    for angle in np.linspace(-math.pi, math.pi, 100_001):
        a = np.array([math.cos(angle), math.sin(angle)])
        low = max((left @ a).max(), right[3] @ a)
        high = min((right @ a).min(), left[0] @ a)
        best = min(best, (low - high) / 2)
    return best


def test_published_states_are_those_that_fit() -> None:
    scenes, pose, state = _good()
    assert infer_published_states(scenes, pose, SHELF).tolist() == state.tolist()
    pose[0, 1, 2], pose[0, 3, 2] = 0.06, -0.07  # a little past the tolerance, upright all the same
    pose[0, 2, 2] = -1.3
    assert infer_published_states(scenes, pose, SHELF).tolist() == state.tolist()
    pose[0, 2, 1] = _height(1.3, 0.055, 0.02)  # now it rests on a corner
    assert infer_published_states(scenes, pose, SHELF)[0, 2] == BookState.LEAN_RIGHT
