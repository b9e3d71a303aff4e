"""What the tests of the exact method share: shelves, scenes that need movement, soundness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bookshelf_scenes import HALF_MM, random_theta

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost


@dataclass(frozen=True)
class Case:
    theta: np.ndarray  # mm
    scene: ShelfScene
    answer: SceneAnswer


def shelf_of(n: int) -> Shelf:
    return Shelf(left=-1e-3 * HALF_MM[n], right=1e-3 * HALF_MM[n])


def upright(
    centres: list[float], sizes: list[tuple[float, float]], inserted: tuple[float, float]
) -> ShelfScene:
    """Stored books standing at centres, sizes (height, width), all in mm."""
    size = 1e-3 * np.array(sizes)
    pose = np.column_stack([1e-3 * np.array(centres), size[:, 0] / 2, np.zeros(len(centres))])
    return ShelfScene(pose, size, 1e-3 * np.array(inserted))


def require_valid(scene: ShelfScene, answer: SceneAnswer, shelf: Shelf) -> None:
    """Independent of the search: the checker at a thousandth of a mm, the cost anew, the bound."""
    assert answer.placement is not None
    scenes = Scenes.of([scene])
    pose, state = answer.placement.pose[None], answer.placement.state[None]
    check = check_contact(scenes, pose, state, shelf, 1e-6)
    assert check.passed.all(), check.explain(0)
    assert abs(compute_movement_cost(scenes, pose)[0] - answer.objective) <= 1e-9 * (
        1 + answer.objective
    )
    assert answer.bound <= answer.objective
    if answer.status == "optimal":
        assert answer.gap <= max(0.01, 1e-4 * answer.objective) * (1 + 1e-6)


def non_trivial(n: int, count: int, seed: int) -> list[Case]:
    """Random scenes whose optimum moves books by more than 1 mm^2."""
    rng, solver = np.random.default_rng(seed), ExactSolver(shelf_of(n))
    found: list[Case] = []
    while len(found) < count:
        theta = random_theta(rng, n, HALF_MM[n])
        scene = Scenes.from_theta(theta[None], "mm")[0]
        answer = solver.solve(scene)
        if answer.objective > 1:
            found.append(Case(theta, scene, answer))
    return found
