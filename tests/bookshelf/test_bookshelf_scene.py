"""Scenes, rows and the movement cost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bookshelf_scenes import PUBLISHED

from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, compute_movement_cost
from climbplan.errors import UsageError


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_rows_survive_the_way_there_and_back(unit: str) -> None:
    rows = PUBLISHED * (1.0 if unit == "mm" else np.tile([1e-3], 17))
    scenes = Scenes.from_theta(rows, unit)  # type: ignore[arg-type]
    assert scenes.pose.shape == (4, 3, 3)
    assert scenes.sizes.shape == (4, 4, 2)
    np.testing.assert_allclose(scenes.theta(unit), rows)  # type: ignore[arg-type]


def test_millimetres_become_metres_and_angles_stay() -> None:
    scene = Scenes.from_theta(PUBLISHED, "mm")[0]
    np.testing.assert_allclose(scene.pose[1], [0.0177754, 0.0295209, 1.0315])
    np.testing.assert_allclose(scene.size[1], [0.075, 0.024])
    np.testing.assert_allclose(scene.inserted, [0.054, 0.020])


def test_every_wrong_number_is_named() -> None:
    rows = PUBLISHED[:2].copy()
    rows[0, 2], rows[0, 9], rows[1, 15], rows[1, 0] = np.nan, 0.0, -1.0, np.inf
    with pytest.raises(UsageError) as caught:
        Scenes.from_theta(rows, "mm")
    text = str(caught.value)
    assert "scene 0, book 0: angle is nan" in text
    assert "scene 0, book 1: width is 0, expected more than 0" in text
    assert "scene 1, inserted: height is -0.001" in text
    assert "scene 1, book 0: x is inf" in text


@pytest.mark.parametrize("columns", [2, 5, 6, 8, 16])
def test_rows_of_another_length_are_refused(columns: int) -> None:
    with pytest.raises(UsageError, match="expected"):
        Scenes.from_theta(np.ones((3, columns)))


def test_millimetres_taken_for_metres_are_refused() -> None:
    with pytest.raises(UsageError, match="at most 100"):
        Scenes.from_theta(PUBLISHED * 10, "m")


def test_movement_cost_by_hand() -> None:
    scenes = Scenes.from_theta(PUBLISHED[:1], "mm")
    pose = np.concatenate([scenes.pose, [[[0.0, 0.0, 0.0]]]], axis=1)
    assert compute_movement_cost(scenes, pose)[0] == 0
    pose[0, 0, 0] += 3e-3
    pose[0, 1, 1] -= 4e-3
    pose[0, 2, 2] = math.pi / 2
    turned = math.cos(math.pi / 2) - math.cos(0.0012)
    assert compute_movement_cost(scenes, pose)[0] == pytest.approx(9 + 16 + turned**2)


def test_least_lean_is_where_the_centre_is_over_the_foot() -> None:
    size = np.array([[0.08, 0.02], [0.05, 0.05]])
    lean = Shelf().min_lean_angle(size)
    # Centre relative to the foot of a book tilted to the left by a: -H/2 sin a + W/2 cos a.
    over = -size[:, 0] / 2 * np.sin(lean) + size[:, 1] / 2 * np.cos(lean)
    np.testing.assert_allclose(over, 0, atol=1e-15)
    assert Shelf(lean_margin=0.1).min_lean_angle(size) == pytest.approx(lean + 0.1)


@pytest.mark.parametrize(
    "wrong",
    [{"left": 0.1}, {"height": 0.0}, {"book_gap": -1e-3}, {"right": math.nan}],
)
def test_shelves_that_are_none_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="shelf"):
        Shelf(**wrong)
