"""The search whose nodes are narrowed: what it proves, at its end and at a limit."""

from __future__ import annotations

import numpy as np
import pytest
from random_products import random_products

from climbplan.arrays import Array, IntArray
from climbplan.certificates.checker import check
from climbplan.solvers.mixed_integer.branch_and_reduce import BranchAndReduce
from climbplan.solvers.mixed_integer.spatial_method import solve_spatial

GAP = 1e-3


def _no_look(x: Array, assignment: IntArray) -> float:
    return np.inf


@pytest.mark.parametrize("seed", [0, 2, 3, 16])
def test_its_bound_is_that_of_its_certificate_and_within_the_gap(seed: int) -> None:
    instance = random_products(seed).instantiate({})
    best = solve_spatial(instance, 1e-5, 60.0, 1e-6)
    cost = np.inf if best.objective is None else best.objective
    search = BranchAndReduce(instance, GAP, cost, _no_look)
    search.run(np.inf, 2000)
    assert search.is_finished
    bound = check(instance, search.build_certificate()).bound
    if best.objective is None:
        assert search.bound == bound == np.inf
        return
    assert bound <= cost + 1e-5 * (1.0 + abs(cost))
    assert bound >= cost - GAP * abs(cost)
    assert bound >= search.bound


def test_a_limit_of_nodes_leaves_a_valid_bound() -> None:
    instance = random_products(9).instantiate({})
    best = solve_spatial(instance, 1e-5, 60.0, 1e-6).objective
    assert best is not None
    search = BranchAndReduce(instance, GAP, best, _no_look)
    search.run(np.inf, 12)
    assert search.num_nodes == 12
    assert not search.is_finished
    bound = check(instance, search.build_certificate()).bound
    assert -np.inf < search.bound <= best
    # Open nodes are narrowed once more by the checker, which can only prove more of them
    assert search.bound - 1e-9 * abs(search.bound) <= bound <= best + 1e-5 * abs(best)
