"""What must hold between the answers to related scenes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from exact_cases import require_valid
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import (
    BookState,
    Scenes,
    Shelf,
    ShelfScene,
    compute_movement_cost,
)

_LIMITS = ExactLimits(nodes=3000)  # what holds must hold of unfinished searches as well


@dataclass(frozen=True)
class Setting:
    scene: ShelfScene
    shelf: Shelf


def _millimetres(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda value: round(value, 2))


@st.composite
def _settings(draw: st.DrawFn) -> Setting:
    """Books of all sorts on shelves between far too narrow and wide, rarely well placed."""
    count = draw(st.integers(1, 3))
    widths, heights = _millimetres(1.0, 40.0), _millimetres(20.0, 125.0)
    size = np.array([(draw(heights), draw(widths)) for _ in range(count + 1)])
    half = draw(st.sampled_from([0.35, 0.5, 0.5, 0.6, 2.0])) * float(size[:, 1].sum())
    rows = []
    for h, w in size[:-1]:
        tilt = draw(st.sampled_from([0.0, math.pi / 2]) | st.floats(0.05, 1.5))
        side = draw(st.sampled_from([-1.0, 1.0]))
        lift = draw(st.sampled_from([0.0, 0.0, 0.0, 15.0]))
        y = (w * math.sin(tilt) + h * math.cos(tilt)) / 2 + lift
        rows.append((draw(_millimetres(-half, half)), y, side * tilt))
    rows.sort()
    scale = np.array([1e-3, 1e-3, 1.0])
    shelf = Shelf(
        left=-1e-3 * half,
        right=1e-3 * half,
        book_gap=1e-3 * draw(st.sampled_from([4.1, 4.1, 1.0])),
        lean_margin=draw(st.sampled_from([0.0, 0.0, 0.1])),
    )
    return Setting(ShelfScene(np.array(rows) * scale, 1e-3 * size[:-1], 1e-3 * size[-1]), shelf)


def _solve(scene: ShelfScene, shelf: Shelf) -> SceneAnswer:
    answer = ExactSolver(shelf, _LIMITS).solve(scene)
    if answer.placement is None:
        assert answer.objective == math.inf
    else:
        require_valid(scene, answer, shelf)
    if answer.status == "infeasible":
        assert answer.bound == math.inf
        assert answer.shortage is not None
    return answer


def _require_no_dearer(one: SceneAnswer, other: SceneAnswer) -> None:
    """Nothing proved says that the optimum of `one` costs more than that of `other`."""
    assert one.bound <= other.objective + 1e-6 * (1 + abs(other.objective))


def _require_same(one: SceneAnswer, other: SceneAnswer) -> None:
    if math.isfinite(one.objective) or math.isfinite(other.objective):
        _require_no_dearer(one, other)
        _require_no_dearer(other, one)


_many = settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])


@_many
@given(_settings())
def test_a_mirrored_scene_has_the_same_optimum(setting: Setting) -> None:
    scene, shelf = setting.scene, setting.shelf
    pose = scene.pose[::-1] * np.array([-1.0, 1.0, -1.0])
    mirrored = ShelfScene(pose, scene.size[::-1].copy(), scene.inserted)
    _require_same(
        _solve(scene, shelf),
        _solve(mirrored, replace(shelf, left=-shelf.right, right=-shelf.left)),
    )


@_many
@given(_settings(), st.floats(-1.0, 1.0))
def test_a_shelf_elsewhere_has_the_same_optimum(setting: Setting, shift: float) -> None:
    scene, shelf = setting.scene, setting.shelf
    moved = ShelfScene(scene.pose + np.array([shift, 0.0, 0.0]), scene.size, scene.inserted)
    elsewhere = replace(shelf, left=shelf.left + shift, right=shelf.right + shift)
    _require_same(_solve(scene, shelf), _solve(moved, elsewhere))


@_many
@given(_settings(), st.floats(0.3, 1.0), st.floats(0.3, 1.0))
def test_a_smaller_inserted_book_never_costs_more(
    setting: Setting, height: float, width: float
) -> None:
    scene, shelf = setting.scene, setting.shelf
    small = ShelfScene(scene.pose, scene.size, scene.inserted * np.array([height, width]))
    _require_no_dearer(_solve(small, shelf), _solve(scene, shelf))


@_many
@given(_settings(), st.floats(0.0, 0.1))
def test_a_wider_shelf_never_costs_more(setting: Setting, extra: float) -> None:
    """Unless the right wall is moved away from a book that leans on it."""
    scene, shelf = setting.scene, setting.shelf
    answer = _solve(scene, shelf)
    if answer.placement is None or answer.placement.state[-2] == BookState.LEAN_RIGHT:
        return
    _require_no_dearer(_solve(scene, replace(shelf, right=shelf.right + extra)), answer)


@_many
@given(_settings())
def test_what_is_placed_well_stays(setting: Setting) -> None:
    """The answer taken for the scene: nothing need be moved; and no shelf is too wide for it."""
    scene, shelf = setting.scene, setting.shelf
    answer = _solve(scene, shelf)
    if answer.placement is None:
        return
    again = ShelfScene(answer.placement.pose[:-1], scene.size, scene.inserted)
    assert compute_movement_cost(Scenes.of([again]), answer.placement.pose[None])[0] == 0.0
    settled = _solve(again, shelf)
    assert settled.bound <= 1e-6
    assert settled.objective <= 0.05  # found by dives, even if the search is not finished


@_many
@given(_settings())
def test_what_is_missing_is_enough(setting: Setting) -> None:
    scene, shelf = setting.scene, setting.shelf
    answer = _solve(scene, shelf)
    if answer.status != "infeasible":
        return
    assert answer.shortage is not None
    if answer.shortage.height > 0:
        higher = replace(shelf, height=shelf.height + answer.shortage.height + 1e-9)
        assert (scene.sizes.min(axis=1) <= higher.height).all()
        assert (scene.sizes.min(axis=1) > shelf.height).any()
        return
    short, enough = answer.shortage.width_bound, answer.shortage.width
    assert 0 <= short <= enough
    wider = replace(shelf, right=shelf.right + enough + 1e-9)
    assert _solve(scene, wider).placement is not None
    assert _solve(scene, replace(shelf, right=shelf.right + short)).placement is None
