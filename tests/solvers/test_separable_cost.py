"""Costs are taken apart into the blocks of variables that they couple."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from climbplan.solvers.separable_cost import is_convex


@pytest.mark.parametrize("seed", range(20))
def test_convexity_is_that_of_the_whole_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 30))
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.05)
    P = A + A.T + np.diag(rng.integers(0, 4, n).astype(float))
    assert is_convex(sparse.csc_matrix(P)) == (np.linalg.eigvalsh(P)[0] > -1e-9)


def test_flat_directions_are_convex_in_spite_of_rounding() -> None:
    rng = np.random.default_rng(0)
    U = rng.normal(size=(3, 8))
    assert is_convex(sparse.csc_matrix(U.T @ U))
    assert not is_convex(sparse.csc_matrix(U.T @ U - 1e-6 * np.eye(8)))
