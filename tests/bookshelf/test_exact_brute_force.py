"""Least movement against brute force, which shares no code with the solver or the checker.

Brute force tries placements, so that the solver may find a cheaper one, never a dearer one, and no
proven bound may exceed what brute force found.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bookshelf_oracle import Oracle, Rules
from bookshelf_scenes import HALF_MM, PUBLISHED
from exact_cases import Case, non_trivial, require_valid, shelf_of, upright

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene


def _require_agreement(case: Case, n: int) -> None:
    answer = case.answer
    assert math.isfinite(answer.objective)
    assert answer.status == "optimal"
    require_valid(case.scene, answer, shelf_of(n))
    best = Oracle(case.theta, Rules(-HALF_MM[n], HALF_MM[n])).solve()
    assert answer.bound <= best + 1e-3, "the bound cuts off what brute force found"
    assert answer.objective <= best + max(0.01, 1e-4 * best) + 1e-3
    # The grid's and the polish's share: ten times less than what another order or state costs.
    assert best <= answer.objective + max(0.05, 2e-3 * answer.objective), "a blunt oracle"


def test_single_books() -> None:
    for case in non_trivial(1, 40, seed=1):
        _require_agreement(case, 1)


@pytest.mark.slow
def test_two_books() -> None:
    for case in non_trivial(2, 12, seed=3):
        _require_agreement(case, 2)


@pytest.mark.slow
def test_more_pairs_of_books() -> None:
    for case in non_trivial(2, 60, seed=4):
        _require_agreement(case, 2)


@pytest.mark.slow
def test_three_books() -> None:
    for case in non_trivial(3, 10, seed=5):
        _require_agreement(case, 3)


@pytest.mark.slow
def test_published_scenes_of_three_books() -> None:
    solver = ExactSolver(shelf_of(3))
    for theta, scene in zip(PUBLISHED, Scenes.from_theta(PUBLISHED, "mm"), strict=True):
        _require_agreement(Case(theta, scene, solver.solve(scene)), 3)


def _fits(scene: ShelfScene, shelf: Shelf, extra: float) -> bool:
    """Whether brute force finds any placement on a shelf that is wider by `extra` [m]."""
    theta = Scenes.of([scene]).theta("mm")[0]
    right = 1e3 * (shelf.right + extra)
    rules = Rules(1e3 * shelf.left, right, 1e3 * shelf.height)
    return Oracle(theta, rules).solve(polish=0) < math.inf


@pytest.mark.parametrize("seed", range(6))
def test_missing_width_is_that_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 1 + seed % 2
    sizes = [(float(h), float(w)) for h, w in zip(
        rng.uniform(60, 108, count), rng.uniform(30, 60, count), strict=True
    )]  # fmt: skip
    scene = upright(np.linspace(-10, 10, count).tolist(), sizes, (90.0, float(rng.uniform(20, 60))))
    total = float(scene.sizes.min(axis=1).sum())
    shelf = Shelf(left=-0.45 * total, right=0.4 * total)
    answer = ExactSolver(shelf).solve(scene)
    assert answer.status == "infeasible"
    assert answer.shortage is not None
    assert 0 <= answer.shortage.width - answer.shortage.width_bound <= 2.1e-5
    assert _fits(scene, shelf, answer.shortage.width + 1e-8)
    assert not _fits(scene, shelf, answer.shortage.width_bound)


def test_missing_width_of_a_book_that_can_only_lean() -> None:
    """It leans as steeply as the clear height lets it: with h = 140, w = 20 below 100 the tilt's
    sine is 0.8, for 20 x 0.8 + 140 x 0.6 = 100, and it takes 140 x 0.8 + 20 x 0.6 = 124."""
    tilt = math.asin(0.8)
    scene = ShelfScene(
        np.array([[0.0, 0.05, -tilt]]), np.array([[0.14, 0.02]]), np.array([0.099, 0.09])
    )
    shelf = Shelf(left=-0.08, right=0.08, height=0.1)
    answer = ExactSolver(shelf).solve(scene)
    assert answer.status == "infeasible"
    assert answer.shortage is not None
    missing = 0.124 + 0.09 - 0.16
    assert answer.shortage.width_bound <= missing + 1e-9
    assert missing - 1e-9 <= answer.shortage.width <= missing + 2.1e-5
    wider = replace(shelf, right=shelf.right + answer.shortage.width)
    require_valid(scene, ExactSolver(wider).solve(scene), wider)
