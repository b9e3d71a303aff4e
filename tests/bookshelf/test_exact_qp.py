"""The least-distance program against a reference, and its certificates."""

from __future__ import annotations

import daqp
import numpy as np
import pytest

from climbplan.bookshelf.exact.qp import CUT_OFF, EMPTY, SOLVED, solve_least_distance


def _solve(C: np.ndarray, b: np.ndarray, cutoff: float = np.inf) -> tuple[int, ...]:
    multiplier, z = np.zeros(len(b)), np.zeros(C.shape[1])
    return solve_least_distance(C, b, cutoff, multiplier, z), multiplier, z


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_a_reference_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solved = empty = 0
    for _ in range(200):
        n, m = int(rng.integers(1, 9)), int(rng.integers(1, 25))
        C = np.ascontiguousarray(rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.6))
        b = rng.normal(size=m) - rng.integers(0, 2)
        status, multiplier, z = _solve(C, b)
        assert (multiplier >= 0).all()
        x, _, flag, _ = daqp.solve(
            np.eye(n), np.zeros(n), C, np.full(m, 1e30), b, np.zeros(m, np.int32)
        )
        if status == SOLVED:
            solved += 1
            assert flag >= 1
            np.testing.assert_allclose(z, x, atol=1e-4 * (1 + np.abs(x).max()))
            np.testing.assert_allclose(C.T @ multiplier, z, atol=1e-6 * (1 + np.abs(z).max()))
            assert (C @ z - b).min() >= -1e-7
            assert multiplier @ (C @ z - b) == pytest.approx(0, abs=1e-5 * (1 + z @ z))
        elif status == EMPTY:
            empty += 1
            assert np.abs(C.T @ multiplier).max() < 1e-7 * max(1, multiplier.max())
            assert b @ multiplier > 0
    assert solved > 50
    assert empty > 10


def test_rows_of_zeros() -> None:
    C = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert _solve(C, np.array([-1.0, 2.0]))[0] == SOLVED
    status, multiplier, _ = _solve(C, np.array([1.0, 2.0]))
    assert status == EMPTY
    assert multiplier.tolist() == [1.0, 0.0]


def test_equal_rows_are_no_trouble() -> None:
    C = np.repeat([[1.0, -1.0]], 5, axis=0)
    status, _, z = _solve(C, np.array([1.0, 2.0, 2.0, 2.0, 0.0]))
    assert status == SOLVED
    np.testing.assert_allclose(z, [1.0, -1.0])


def test_cutoff_comes_with_multipliers_that_show_it() -> None:
    C, b = np.eye(3), np.array([3.0, 4.0, 5.0])  # least value 25
    status, multiplier, _ = _solve(C, b, cutoff=10.0)
    assert status == CUT_OFF
    assert multiplier @ b - 0.5 * np.sum((C.T @ multiplier) ** 2) > 10.0
