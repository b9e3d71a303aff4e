"""Pictures: every book drawn where it is, moves as arrows, failures said."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bookshelf_scenes import PUBLISHED
from matplotlib.colors import to_hex
from matplotlib.patches import FancyArrowPatch, Polygon

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.pages.pictures import (
    COLORS,
    INSERTED,
    build_picture,
    draw_gallery,
    draw_scene,
    encode_png,
    infer_states,
    is_moved,
)
from climbplan.bookshelf.scene.rectangles import compute_corners
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf

SHELF = Shelf()


@pytest.fixture(scope="module")
def solved():  # type: ignore[no-untyped-def]
    scenes = Scenes.from_theta(PUBLISHED, "mm")
    return scenes, ExactSolver(SHELF).solve_all(scenes)


def test_before_and_after(solved) -> None:  # type: ignore[no-untyped-def]
    scenes, answers = solved
    scene, answer = scenes[0], answers[0]
    figure = draw_scene(build_picture(scene, answer, "A $cene_"), SHELF)
    before, after = figure.axes
    drawn = [p for p in before.patches if isinstance(p, Polygon)]
    assert len(drawn) == 3
    np.testing.assert_allclose(
        drawn[1].get_xy()[:4], 1e3 * compute_corners(scene.pose[1], scene.size[1])
    )
    books = [p for p in after.patches if isinstance(p, Polygon) and p.get_facecolor()[3] > 0]
    colors = [to_hex(p.get_facecolor()).upper() for p in books]
    expected = [COLORS[BookState(s)].upper() for s in answer.placement.state[:3]]
    assert colors == [*expected, INSERTED.upper()]
    arrows = [p for p in after.patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) == sum(is_moved(scene, answer.placement, k) for k in range(3)) > 0
    assert "63.91 mm²" in after.get_title(loc="right")
    assert encode_png(figure).startswith(b"\x89PNG")


def test_a_gallery_of_all(solved) -> None:  # type: ignore[no-untyped-def]
    scenes, answers = solved
    items = [
        build_picture(s, a, str(k)) for k, (s, a) in enumerate(zip(scenes, answers, strict=True))
    ]
    figure = draw_gallery(items, SHELF, columns=3, title="Four")
    visible = [ax for ax in figure.axes if ax.get_visible()]
    assert len(visible) == 8
    assert encode_png(figure).startswith(b"\x89PNG")


def test_no_placement_is_shown_as_such() -> None:
    theta = np.array([[-61, 40, 0, 80, 40, 0, 40, 0, 80, 40, 61, 40, 0, 80, 40, 80, 60.0]])
    scenes = Scenes.from_theta(theta, "mm")
    answer = ExactSolver(SHELF).solve(scenes[0])
    item = build_picture(scenes[0], answer)
    assert "17.78 mm of width are missing" in item.caption
    figure = draw_scene(item, SHELF)
    assert "no placement" in [t.get_text() for t in figure.axes[1].texts]
    assert encode_png(draw_gallery([item], SHELF)).startswith(b"\x89PNG")


def test_states_before_are_those_of_the_angles() -> None:
    angle = np.array([0.0, 0.04, 0.3, -0.3, math.pi / 2, -1.56, math.pi, 4.712])
    assert infer_states(angle).tolist() == [2, 2, 1, 3, 0, 4, 2, 4]
