"""Stating a program: coefficients, counts, parameters and the exact check by block."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from climbplan.program import Polytope, Program
from climbplan.program.scalar import object_array


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
    instance = p.instantiate(theta)
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
    first, second = p.instantiate({"goal": [0, 0]}), p.instantiate({"goal": [1, 0]})
    assert (first.A != second.A).nnz == 0
    np.testing.assert_allclose(second.row_lower - first.row_lower, [1, 0])
    compiled = p._compiled
    p.instantiate({"goal": [2, 2]})
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
    p.ball("product", np.array([x[0] * x[1], x[0]], dtype=object), 1.0)
    with pytest.raises(ValueError, match="not affine"):
        p.instantiate()
    triple = Program("triple")
    t = triple.continuous("t", (3,))
    triple.between("product", np.array([t[0] * t[1] * t[2]], dtype=object), 0, 1)
    with pytest.raises(ValueError, match="not affine or bilinear"):
        triple.instantiate()
    loose = Program("loose")
    u = loose.continuous("u", (1,))
    loose.when("if", u[0], u, upper=1.0)
    with pytest.raises(ValueError, match="one stated binary"):
        loose.instantiate()
    q = Program("cubic")
    y = q.continuous("y", (1,))
    q.minimise("cube", y[0] ** 3)
    with pytest.raises(ValueError, match="not quadratic"):
        q.instantiate()
    with pytest.raises(ValueError, match="parameters"):
        small().instantiate({"gaol": [0, 0]})
    with pytest.raises(ValueError, match="shape"):
        small().instantiate({"goal": [0, 0, 0]})


def bilinear() -> Program:
    """x0 x1 + theta x1^2 = 1 with two states; a state says where x0 lies."""
    p = Program("bilinear")
    theta = p.parameter("theta", (1,))
    x = p.continuous("x", (2,), -2.0, 2.0, unit="m")
    state = p.binary("state", (2,))
    p.exactly_one("one_state", state[None])
    p.equal("area", np.array([x[0] * x[1] + theta[0] * x[1] ** 2 - 1 + 3 * x[0]], dtype=object))
    p.when("left", state[0], x[:1], upper=-0.5, unit="m")
    p.when("right", state[1], np.array([x[0] - x[0] * x[1]], dtype=object), lower=0.25, unit="m")
    p.when("not_left", state[0], x[1:], lower=0.0, unit="m", value=False)
    p.minimise("size", np.sum(x**2))
    return p


def test_products_are_found_and_shared() -> None:
    p = bilinear()
    counts = p.counts()
    assert counts["products"] == 2  # x0 x1 in the row and in the implication, x1^2
    assert counts["binary"] == 2
    assert counts["continuous"] == 2
    assert counts["implications"] == 3
    instance = p.instantiate({"theta": [0.5]})
    assert instance.features == {"integers", "implications", "products"}
    x = p.point({"x": [0.7, -1.2], "state": [0, 1]})
    row = instance.A @ x + instance.Q @ instance.products.values(x)
    assert row[0] == instance.row_lower[0] == 1.0  # the sum of the states
    expected = 0.7 * -1.2 + 0.5 * 1.44 - 1 + 2.1
    np.testing.assert_allclose(row[1] - instance.row_lower[1], expected)
    other = p.instantiate({"theta": [2.0]})
    assert (other.A != instance.A).nnz == 0
    assert (other.Q != instance.Q).nnz == 1


def test_implications_hold_only_for_their_value() -> None:
    p = bilinear()
    theta = {"theta": [0.5]}

    def residuals(x: list[float], state: list[float]) -> dict[str, float]:
        report = p.check(p.point({"x": x, "state": state}), theta)
        return {b.name: b.residual for b in report.blocks}

    right = residuals([0.1, 0.5], [0, 1])
    assert right["left"] == 0
    assert right["right"] == pytest.approx(0.25 - (0.1 - 0.05))
    assert right["not_left"] == 0
    left = residuals([0.1, -0.5], [1, 0])
    assert left["left"] == pytest.approx(0.6)
    assert left["right"] == 0
    assert left["not_left"] == 0
    assert residuals([0.1, -0.5], [0, 1])["not_left"] == pytest.approx(0.5)
    half = residuals([0.1, -0.5], [0.4, 0.6])
    assert half["integrality.state"] == pytest.approx(0.4)
    x = p.point({"x": [0.1, -0.5], "state": [0.4, 0.6]})
    assert p.instantiate(theta).violation(x) == pytest.approx(max(half.values()))


def test_scalar_expressions_are_blocks_of_one() -> None:
    p = Program("scalars")
    z = p.binary("z", (3,))
    x = p.continuous("x", (2,), 0.0, 1.0)
    p.exactly_one("one", z)
    p.between("sum", x[0] + x[1], 0.0, 1.5)
    p.when("if", z[0], x[0] * x[1], upper=0.2)
    counts = p.counts()
    assert counts["by_block"] == {"one": 1, "sum": 1, "if": 1}
    report = p.check(p.point({"z": [1, 0, 0], "x": [1.0, 0.9]}))
    by_name = {b.name: b.residual for b in report.blocks}
    assert by_name["one"] == 0
    assert by_name["sum"] == pytest.approx(0.4)
    assert by_name["if"] == pytest.approx(0.7)


def test_an_element_times_an_array_is_an_array_of_scalars() -> None:
    p = Program("line")
    x, y = p.continuous("x", (2,)), p.continuous("y", (1,))
    z = p.continuous("z", (3, 2))
    slope = np.array([1.0, 0.5])
    p.equal("on_line", x - y[0] * slope)
    p.equal("all_on_line", z - (2 * y[0] - 1) * slope)
    p.equal("from_list", x + [1.0, 3.0] * y[0] / 2)
    instance = p.instantiate()
    values = p.point({"x": [3.0, 4.0], "y": [2.0], "z": [[0, 0], [1, 0], [0, 1]]})
    residual = instance.A @ values - instance.row_lower
    expected = [[1.0, 3.0], [-3, -1.5], [-2, -1.5], [-3, -0.5], [4.0, 7.0]]
    np.testing.assert_allclose(residual, np.ravel(expected))
    assert p.counts()["by_block"] == {"on_line": 2, "all_on_line": 6, "from_list": 2}


@pytest.mark.filterwarnings("error")  # CasADi warns of functions of NumPy that it takes over
def test_functions_of_numpy_return_scalars() -> None:
    x = Program("functions").continuous("x", (2,))
    for value in (np.sin(x[0]), np.sqrt(x)[1], np.arctan2(x, x[1])[0], np.sum(x), -x[0], abs(x[0])):
        assert (value * np.ones((3, 1, 2))).shape == (3, 1, 2)
    matrix = ca.SX.eye(2)
    assert type(x[0] * matrix) is ca.SX
    assert (x[0] * matrix).shape == (2, 2)


def test_matrices_of_casadi_are_read_as_arrays() -> None:
    p = Program("casadi")
    x = p.continuous("x", (2, 3))
    p.between("column", ca.vertcat(x[0, 0], 2 * x[1, 0]), 0.0, [1.0, 2.0])
    p.between("matrix", ca.SX(np.eye(2, 3)) * 3 + x[0, 1], upper=0.0)
    instance = p.instantiate()
    column, matrix = instance.A[:2].toarray(), instance.A[2:].toarray()
    np.testing.assert_array_equal(column, [[1, 0, 0, 0, 0, 0], [0, 0, 0, 2, 0, 0]])
    np.testing.assert_array_equal(matrix, np.tile([0, 1, 0, 0, 0, 0], (6, 1)))
    np.testing.assert_array_equal(instance.row_upper[2:], -3 * np.eye(2, 3).ravel())
    with pytest.raises(ValueError, match=r"casadi: 'mixed': a scalar expected at \[1\], got a 2 b"):
        p.equal("mixed", object_array([x[0, 0], ca.vertcat(x[0, 0], x[0, 1])]))
    with pytest.raises(ValueError, match=r"'ragged': entries of one shape .* \(\), \(2,\)"):
        p.equal("ragged", [x[0, 0], x[:, 1]])


def test_bounds_that_cross_or_do_not_fit_are_refused_by_name() -> None:
    p = Program("bounds")
    x, z = p.continuous("x", (2,)), p.binary("z", (2,))
    with pytest.raises(ValueError, match=r"bounds: block 'row': lower <= upper .* 2 and upper 1"):
        p.between("row", x[0], lower=2, upper=1)
    with pytest.raises(ValueError, match=r"block 'if': .* lower 3 and upper 1 at \[1\]"):
        p.when("if", z, x, lower=[0.0, 3.0], upper=1.0)
    with pytest.raises(ValueError, match=r"block 'curve': .* upper -1"):
        p.smooth("curve", x[0] ** 3, upper=-1.0)
    with pytest.raises(ValueError, match=r"variable 'y': .* lower nan"):
        p.continuous("y", (1,), lower=np.nan)
    with pytest.raises(ValueError, match=r"block 'row': upper: shape \(2,\) expected.* got \(3,\)"):
        p.between("row", x, upper=np.zeros(3))
    with pytest.raises(ValueError, match=r"block 'disc': radius: shape \(\) expected"):
        p.ball("disc", x, [1.0, 2.0])


def test_a_vector_is_no_cost() -> None:
    p = Program("cost")
    x = p.continuous("x", (2,))
    with pytest.raises(ValueError, match=r"cost 'size': one scalar expected, .* shape \(2,\)"):
        p.minimise("size", x**2)
    p.minimise("one", x[:1])
    p.minimise("size", x @ x)
    assert p.instantiate().objective(np.array([2.0, 1.0])) == 7.0
