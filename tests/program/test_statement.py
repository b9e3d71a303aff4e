"""Stating a program: coefficients, counts, parameters and the exact check by block."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.program import Polytope, Program


def small() -> Program:
    p = Program("small")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (2, 2), -1.0, 2.0, unit="m")
    p.between("sum", x[0] + 2 * x[1] - goal, -0.5, 0.5, unit="m")
    p.ball("near", x - 0.25, [0.5, 1.0], unit="m")
    left = Polytope("left", np.array([[1.0, 0]]), np.array([0.0]), np.zeros((0, 2)), np.zeros(0))
    line = Polytope("line", np.zeros((0, 2)), np.zeros(0), np.array([[0.0, 1]]), np.array([1.0]))
    p.one_of("side", x, [[left, line], [line]], unit="m")
    p.minimise("spread", np.sum((x[0] - x[1]) ** 2))
    p.minimise("pull", 3 * x[0, 0] + goal[1] * x[1, 1] + 5)
    return p


def test_instance_reproduces_the_statement() -> None:
    p = small()
    theta = {"goal": [0.3, -2.0]}
    instance = p.at(theta)
    rng = np.random.default_rng(0)
    for _ in range(5):
        v = rng.normal(size=(2, 2))
        x = p.point({"x": v})
        expected = ((v[0] - v[1]) ** 2).sum() + 3 * v[0, 0] - 2.0 * v[1, 1] + 5
        assert instance.objective(x) == pytest.approx(expected)
        row = instance.A @ x
        np.testing.assert_allclose(row - instance.row_lower, v[0] + 2 * v[1] - [0.3, -2.0] + 0.5)
        excess = np.linalg.norm(v - 0.25, axis=1) - [0.5, 1.0]
        np.testing.assert_allclose(instance.balls[0].excess(x), excess)
        np.testing.assert_allclose(
            instance.choices[0].violations(x), [max(v[0, 0], 0), abs(v[0, 1] - 1)]
        )


def test_parameters_update_numbers_only() -> None:
    p = small()
    first, second = p.at({"goal": [0, 0]}), p.at({"goal": [1, 0]})
    assert (first.A != second.A).nnz == 0
    np.testing.assert_allclose(second.row_lower - first.row_lower, [1, 0])
    compiled = p._compiled
    p.at({"goal": [2, 2]})
    assert p._compiled is compiled


def test_counts_by_block() -> None:
    counts = small().counts()
    assert counts["continuous"] == 4
    assert counts["binary"] == 3
    assert counts["linear_rows"] == 2
    assert counts["balls"] == 2
    assert counts["by_block"] == {"sum": 2, "near": 2, "side": 3}


def test_check_names_the_violated_block() -> None:
    p = small()
    theta = {"goal": [0.0, 0.0]}
    good = p.point({"x": [[0.0, 0.1], [0.0, 1.0]]})
    report = p.check(good, theta)
    by_name = {b.name: b for b in report.blocks}
    assert by_name["bounds.x"].residual == 0
    assert by_name["sum"].residual == pytest.approx(1.6)
    assert by_name["sum"].index == (1,)
    assert by_name["side"].residual == 0
    bad = p.point({"x": [[0.0, 0.1], [3.0, 0.8]]})
    by_name = {b.name: b for b in p.check(bad, theta).blocks}
    assert by_name["bounds.x"].residual == pytest.approx(1.0)
    assert by_name["bounds.x"].index == (1, 0)
    assert by_name["side"].residual == pytest.approx(0.2)
    assert not p.check(bad, theta).passed(1e-6)
    assert p.check(bad, theta).worst().unit == "m"
    # A pinned assignment is judged as given, not as the nearest one.
    pinned = p.check(good, theta, assignment=np.array([1, 0]))
    assert {b.name: b for b in pinned.blocks}["side"].residual == pytest.approx(0.9)


def test_mistakes_in_statements_are_refused() -> None:
    p = Program("wrong")
    x = p.continuous("x", (2,))
    with pytest.raises(ValueError, match="stated twice"):
        p.continuous("x", (2,))
    p.between("product", np.array([x[0] * x[1]], dtype=object), 0, 1)
    with pytest.raises(ValueError, match="not affine"):
        p.at()
    q = Program("cubic")
    y = q.continuous("y", (1,))
    q.minimise("cube", y[0] ** 3)
    with pytest.raises(ValueError, match="not quadratic"):
        q.at()
    with pytest.raises(ValueError, match="parameters"):
        small().at({"gaol": [0, 0]})
    with pytest.raises(ValueError, match="shape"):
        small().at({"goal": [0, 0, 0]})
