"""Branch and bound and SCIP, two independent methods, on the same random scenes."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import stepping_scene

from climbplan.program import Instance
from climbplan.solvers.registry import solve

SCENES = 26


def scene(seed: int) -> Instance:
    """General convex polygons; odd seeds on tilted walls, every third with a box in the way."""
    rng = np.random.default_rng(1000 + seed)
    short = seed % 8 == 7  # steps too short for the patches' distance
    return stepping_scene(
        seed,
        rounds=2,
        limbs=1 if seed % 3 == 0 else 2,
        patches=2 + seed % 2,
        tilted=seed % 2 == 1,
        step=0.12 if short else rng.uniform(0.4, 0.6),
        reach=rng.uniform(0.7, 1.0),
        blocked=seed % 3 == 0,
        goal_tolerance=0.15 if short else None,
    ).instantiate()


@pytest.mark.parametrize("seed", range(SCENES))
def test_same_optimum(seed: int) -> None:
    instance = scene(seed)
    ours = solve(instance, "branch-and-bound", gap=1e-4)
    other = solve(instance, "scip", gap=1e-4, time_limit=60.0)
    if ours.status == "infeasible":
        assert other.status == "infeasible"
        return
    assert ours.status == "optimal"
    assert ours.objective is not None
    assert other.objective is not None
    assert ours.objective == pytest.approx(other.objective, rel=1e-3)
    assert ours.bound <= other.objective * (1 + 1e-6)
    assert other.bound <= ours.objective * (1 + 1e-3)


def test_some_scenes_are_infeasible_and_most_are_not() -> None:
    statuses = [solve(scene(seed), "branch-and-bound").status for seed in range(SCENES)]
    assert 2 <= statuses.count("infeasible") <= 6
    assert statuses.count("optimal") >= 20


def test_scip_keeps_its_incumbent_at_the_limit_or_says_limit() -> None:
    instance = stepping_scene(
        25, rounds=4, limbs=3, step=0.42, reach=0.8, blocked=True
    ).instantiate()
    result = solve(instance, "scip", gap=1e-6, time_limit=0.5)
    assert result.status in ("feasible", "limit", "optimal")
    best = solve(instance, "branch-and-bound").objective
    assert best is not None
    assert result.bound <= best * (1 + 1e-4)
    if result.status == "limit":
        assert result.x is None
    else:
        assert result.x is not None
        assert instance.violation(result.x, result.assignment) <= 2e-6
