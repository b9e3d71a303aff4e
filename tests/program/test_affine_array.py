"""Arrays with numeric coefficients against the same formulas on numbers, and against scalars."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from climbplan.program import Polytope, Program
from climbplan.program.affine_array import AffineArray


def value(expression: AffineArray, x: np.ndarray) -> np.ndarray:
    found = expression.coefficients @ x + expression.constants
    return np.asarray(found).reshape(expression.shape)


def formulas(a: Any, b: Any) -> list[Any]:
    """a: (4, 2, 3), b: (4, 3); what a statement does with its variables."""
    numbers = np.arange(6.0).reshape(2, 3)
    longer = np.concatenate([numbers[None], a])
    return [
        a - b[:, None],
        numbers - a,
        2.0 * a + numbers,
        a * numbers,
        np.diff(longer, axis=0),
        longer[:-1, None]
        + np.array([0.25, 0.75])[:, None, None] * np.diff(longer, axis=0)[:, None],
        (b - 1.0) @ np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0], [4.0, 0.0, 0.5]]).T,
        np.stack([a[..., 0] - a[..., 1], a[..., 2] * numbers[:, 1]], axis=-1),
        np.concatenate([a, np.broadcast_to(b[:, None], (4, 2, 3))], axis=-1),
        b[-1],
    ]


def test_operations_are_those_of_numbers() -> None:
    rng = np.random.default_rng(0)
    p = Program("p")
    p.continuous("a", (4, 2, 3))
    p.continuous("b", (4, 3))
    x = rng.normal(size=36)
    stated = formulas(p.affine("a"), p.affine("b"))
    known = formulas(x[:24].reshape(4, 2, 3), x[24:].reshape(4, 3))
    for ours, theirs in zip(stated, known, strict=True):
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(value(ours, x), theirs, atol=1e-12)
        squares = ours.sum_of_squares()
        cost = 0.5 * x @ (squares.P @ x) + squares.q @ x + squares.constant
        assert cost == pytest.approx(np.sum(theirs**2))


def test_vectors_are_mixed_by_a_matrix_each() -> None:
    rng = np.random.default_rng(1)
    p = Program("p")
    p.continuous("a", (4, 1, 3))
    x, matrices = rng.normal(size=12), rng.normal(size=(5, 3, 2))
    mixed = p.affine("a").along(matrices)
    known = np.einsum("mnd,ndk->mnk", np.broadcast_to(x.reshape(4, 1, 3), (4, 5, 3)), matrices)
    assert mixed.shape == (4, 5, 2)
    np.testing.assert_allclose(value(mixed, x), known, atol=1e-12)


def stated(numeric: bool) -> Program:
    """One program twice: with scalars, and with numeric coefficients where they may be."""
    p = Program("both")
    scalars = p.continuous("a", (4, 2, 3), -1.0, 2.0)
    a: Any = p.affine("a") if numeric else scalars
    later = p.continuous("c", (2,))
    p.between("products", later[:1] * later[1:], -1.0, 1.0)
    p.between("steps", np.diff(a, axis=0), -0.5, 0.5)
    p.equal("sum", np.array([later[0] - scalars[0, 0, 0]], dtype=object))
    p.ball("apart", a[:, 0] - a[:, 1], 2.0)
    box = np.vstack([np.eye(3), -np.eye(3)])
    half = [Polytope.halfspaces(f"{k}", box, np.full(6, 1.0 + k)) for k in range(2)]
    p.one_of("box", a, [half] * 8)
    squares = a.sum_of_squares() if numeric else np.sum(a**2)
    p.minimise("size", 0.3 * squares)
    p.minimise("later", later[0] ** 2 + later[1])
    return p


def test_a_program_is_the_same_either_way() -> None:
    one, other = stated(False).instantiate(), stated(True).instantiate()
    for name in ("q", "lower", "upper", "row_lower", "row_upper"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-12)
    assert one.constant == pytest.approx(other.constant)
    for ours, theirs in (
        (one.P, other.P),
        (one.A, other.A),
        (one.Q, other.Q),
        (one.balls[0].F, other.balls[0].F),
        *((a.E, b.E) for a, b in zip(one.choices, other.choices, strict=True)),
    ):
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours.toarray(), theirs.toarray(), atol=1e-12)
    assert stated(False).counts() == stated(True).counts()


def test_what_numpy_cannot_do_is_refused_and_not_done_scalar_by_scalar() -> None:
    p = Program("p")
    p.continuous("a", (2,))
    with pytest.raises(TypeError):
        np.cumsum(p.affine("a"))  # type: ignore[call-overload]
