"""Bounds of nodes against the cost of placements in them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bookshelf_oracle import LEFT, RIGHT, TILT, Oracle, Rules
from bookshelf_scenes import HALF_MM, random_theta

from climbplan.bookshelf.exact.problem import ALLOWED, LEAN_FROM, build_problem
from climbplan.bookshelf.exact.qp import SOLVED
from climbplan.bookshelf.exact.relaxation import solve_relaxation
from climbplan.bookshelf.exact.workspace import create_workspace
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf


def _setting(rng: np.random.Generator, n: int):  # type: ignore[no-untyped-def]
    half = HALF_MM[n]
    theta = random_theta(rng, n, half)
    scene = Scenes.from_theta(theta[None], "mm")[0]
    shelf = Shelf(left=-1e-3 * half, right=1e-3 * half)
    return Oracle(theta, Rules(-half, half)), build_problem(scene, shelf), create_workspace(n)


def _draw(rng: np.random.Generator, problem, n: int):  # type: ignore[no-untyped-def]
    """States and tilts of all books."""
    states = [int(s) for s in rng.integers(0, 4, n)] + [int(rng.choice([0, 2]))]
    tilts = [
        TILT[s] if s in TILT else rng.uniform(problem.book[k, LEAN_FROM], math.pi / 2)
        for k, s in enumerate(states)
    ]
    return tuple(states), tuple(tilts)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_given_states_and_tilts_are_placed_as_by_the_oracle(n: int) -> None:
    rng = np.random.default_rng(n)
    placed = 0
    for _ in range(60):
        oracle, problem, sheet = _setting(rng, n)
        for _ in range(6):
            states, tilts = _draw(rng, problem, n)
            slot = int(rng.integers(0, n + 1))
            mask = np.array([1 << s for s in states])
            span = np.array([*tilts[:n], *tilts[:n]])
            status, bound = solve_relaxation(problem, sheet, slot, mask, span, np.inf)
            expected = oracle.place(slot, states, tilts)
            assert (status == SOLVED) == (expected < math.inf)
            if status == SOLVED:
                placed += 1
                assert bound == pytest.approx(expected, rel=1e-5, abs=1e-4)
    assert placed > 20


@pytest.mark.parametrize("n", [2, 3])
def test_no_placement_costs_less_than_a_node_that_holds_it(n: int) -> None:
    rng = np.random.default_rng(10 + n)
    compared, tight = 0, 0
    for _ in range(60):
        oracle, problem, sheet = _setting(rng, n)
        for _ in range(8):
            states, tilts = _draw(rng, problem, n)
            slot = int(rng.integers(0, n + 1))
            cost = oracle.place(slot, states, tilts)
            if cost == math.inf:
                continue
            # A node around it: some books undecided, tilts in intervals.
            mask = np.array([1 << s for s in states])
            span = np.array([*tilts[:n], *tilts[:n]])
            for k in range(n):
                if rng.random() < 0.4:
                    mask[k] |= int(rng.integers(0, 16)) & int(problem.book[k, ALLOWED])
                if states[k] in (LEFT, RIGHT) and rng.random() < 0.8:
                    width = 10.0 ** rng.uniform(-4, 0)
                    span[k] = max(tilts[k] - width * rng.random(), problem.book[k, LEAN_FROM])
                    span[n + k] = min(tilts[k] + width * rng.random(), math.pi / 2)
            _, bound = solve_relaxation(problem, sheet, slot, mask, span, np.inf)
            compared += 1
            tight += bound > 0.9 * cost
            assert bound <= cost + 1e-3
    assert compared > 40
    assert tight > 5  # bounds of next to nothing would be no test


def test_a_cutoff_is_exceeded_only_with_proof() -> None:
    rng = np.random.default_rng(5)
    cut = 0
    for _ in range(100):
        oracle, problem, sheet = _setting(rng, 3)
        states, tilts = _draw(rng, problem, 3)
        cost = oracle.place(1, states, tilts)
        if cost == math.inf or cost < 1:
            continue
        mask = np.array([1 << s for s in states])
        span = np.array([*tilts[:3], *tilts[:3]])
        _, bound = solve_relaxation(problem, sheet, 1, mask, span, 0.5 * cost)
        assert bound > 0.5 * cost
        assert bound <= cost + 1e-3
        cut += 1
    assert cut > 5
