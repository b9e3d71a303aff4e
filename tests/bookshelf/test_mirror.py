"""Mirrored scenes: valid where the scene was, at the same cost, and the mirror undoes itself."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.mirror import SolvedScene, mirror_scene
from climbplan.bookshelf.scene.rectangles import find_slots
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost

SHELF = Shelf()
SOLVER = ExactSolver(SHELF)


def _scene(rng: np.random.Generator) -> ShelfScene:
    """Three upright books with gaps that are too narrow for a fourth."""
    size = np.stack([rng.uniform(0.06, 0.09, 4), rng.uniform(0.02, 0.03, 4)], axis=1)
    left = SHELF.left + np.cumsum([0.004, size[0, 1] + 0.011, size[1, 1] + 0.012])
    pose = np.stack([left + size[:3, 1] / 2, size[:3, 0] / 2, np.zeros(3)], axis=1)
    return ShelfScene(pose, size[:3], size[3])


@pytest.mark.parametrize("seed", range(3))
def test_a_shelf_that_is_not_about_zero(seed: int) -> None:
    """Mirrored about its own middle a placement holds; about zero it would be beyond a wall."""
    scene, shift = _scene(np.random.default_rng(seed)), np.array([0.03, 0.0, 0.0])
    scene = ShelfScene(scene.pose + shift, scene.size, scene.inserted)
    shelf = Shelf(left=SHELF.left + 0.03, right=SHELF.right + 0.03)
    placement = ExactSolver(shelf).solve(scene).placement
    assert placement is not None
    for middle, holds in ((0.03, True), (0.0, False)):
        there = mirror_scene(SolvedScene(scene, placement), middle)
        pose, state = there.placement.pose[None], there.placement.state[None]
        assert check_contact(Scenes.of([there.scene]), pose, state, shelf).passed[0] == holds


@pytest.mark.parametrize("seed", range(6))
def test_mirrored_placements_hold_at_the_same_cost(seed: int) -> None:
    scene = _scene(np.random.default_rng(seed))
    placement = SOLVER.solve(scene).placement
    assert placement is not None
    there = mirror_scene(SolvedScene(scene, placement))
    one = Scenes.of([there.scene])
    one.require()
    check = check_contact(one, there.placement.pose[None], there.placement.state[None], SHELF)
    assert check.passed[0], check.explain(0)
    cost = compute_movement_cost(Scenes.of([scene]), placement.pose[None])[0]
    assert compute_movement_cost(one, there.placement.pose[None])[0] == pytest.approx(cost)
    assert find_slots(there.placement.pose[None], one.sizes)[0] == there.placement.slot
    back = mirror_scene(there)
    assert back.scene.pose == pytest.approx(scene.pose)
    assert (back.placement.state == placement.state).all()
    assert back.placement.slot == placement.slot
    assert SOLVER.solve(there.scene).objective == pytest.approx(
        SOLVER.solve(scene).objective, abs=0.02
    )
