"""Problems of a user's own: what they may leave out, and what is said about mistakes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.program import Problem, Program, StatementError


def program() -> Program:
    p = Program("pond")
    goal = p.parameter("goal", (2,))
    weight = p.parameter("weight", ())
    x = p.continuous("x", (2,), -1.0, 3.0)
    z = p.binary("z", (1,))
    p.when("bank", z[0], x[0], lower=1.0)
    p.minimise("distance", np.sum((x - goal) ** 2) + weight[()] * (1 - z[0]))
    return p


THETA = {"goal": [0.0, 0.5], "weight": 2.0}


def test_features_are_the_parameters_if_nothing_else_is_stated() -> None:
    problem = Problem("pond", program())
    np.testing.assert_array_equal(problem.feature_vector(THETA), [0.0, 0.5, 2.0])
    own = Problem("pond", program(), features=lambda theta: theta["weight"])
    np.testing.assert_array_equal(own.feature_vector(THETA), [2.0])


def test_parameters_go_into_a_vector_and_back() -> None:
    problem = Problem("pond", program())
    theta = problem.split(problem.program.theta(problem.numbers(THETA)))
    assert theta["goal"].shape == (2,)
    assert theta["weight"].shape == ()
    assert problem.instance(theta).objective(np.zeros(3)) == pytest.approx(2.25)
    with pytest.raises(UsageError, match="3 parameters expected"):
        problem.split(np.zeros(4))


def test_a_start_may_leave_blocks_out() -> None:
    problem = Problem("pond", program(), start=lambda theta: {"x": theta["goal"]})
    guess = problem.start_point(THETA, np.full(3, 0.25))
    assert guess is not None
    np.testing.assert_array_equal(guess, [0.0, 0.5, 0.25])
    assert Problem("pond", program()).start_point(THETA, np.zeros(3)) is None


@pytest.mark.parametrize(
    ("fields", "fragment"),
    [
        ({"name": ""}, "name must be text"),
        ({"program": 3}, "`program` must be a Program, got int"),
        ({"program": Program("empty")}, "states no variables"),
        ({"sample": 3}, "`sample` must be a function"),
        ({"start": {"x": 1}}, "`start` must be a function"),
        ({"partitions": {"y": 3}}, "partition of 'y': no such continuous variable, there are x"),
        ({"partitions": {"z": 3}}, "no such continuous variable"),
        ({"partitions": {"x": 0}}, "at least one piece"),
        ({"partitions": {"x": [1.0, 0.5]}}, "increasing knots"),
    ],
)
def test_wrong_fields(fields: dict[str, Any], fragment: str) -> None:
    with pytest.raises(StatementError, match=fragment):
        Problem(**{"name": "pond", "program": program(), **fields})


@pytest.mark.parametrize(
    ("theta", "fragment"),
    [
        ({"goal": [0, 0]}, "expected"),
        ({"goal": [0, 0], "weight": 1, "wind": 2}, "wind"),
        ({"goal": [0, 0, 0], "weight": 1}, r"goal: shape \(2,\) expected"),
        ({"goal": [0, np.nan], "weight": 1}, "goal not finite"),
        ({"goal": ["a", "b"], "weight": 1}, "could not convert"),
    ],
)
def test_wrong_parameters(theta: dict[str, Any], fragment: str) -> None:
    with pytest.raises(UsageError, match=fragment):
        Problem("pond", program()).instance(theta)


def test_numbers_that_are_none() -> None:
    p = Program("bounds")
    with pytest.raises(ValueError, match="variable 'x': lower <= upper expected, got lower nan"):
        p.continuous("x", (2,), [0.0, np.nan], 1.0)
    x = p.continuous("y", (1,), 0.0, 1.0)
    weight = p.parameter("weight", ())
    p.minimise("cost", x[0] / weight[()])
    problem = Problem("bounds", p)
    assert problem.instance({"weight": 2.0}).q[0] == pytest.approx(0.5)
    with pytest.raises(StatementError, match="a number of its cost is not finite"):
        problem.instance({"weight": 0.0})


def leaving(argument: Any) -> Any:
    raise SystemExit(0)


def raising(argument: Any) -> Any:
    raise ZeroDivisionError("by zero")


@pytest.mark.parametrize(
    ("role", "function", "fragment"),
    [
        ("sample", raising, "`sample` raised ZeroDivisionError: by zero"),
        ("sample", lambda rng: 3, "must return a mapping, got int"),
        ("sample", lambda rng: {"goal": [0, 0]}, "from `sample`"),
        ("sample", leaving, "`sample` raised SystemExit: 0"),
        ("features", raising, "`features` raised ZeroDivisionError"),
        ("features", lambda theta: [np.inf], "not finite"),
        ("features", lambda theta: "far", "`features`"),
        ("start", raising, "`start` raised ZeroDivisionError"),
        ("start", lambda theta: {"y": 1}, "`start` names 'y', its variables are x, z"),
        ("start", lambda theta: {"x": [1]}, r"shape \(2,\) expected"),
        ("start", lambda theta: 1, "must return a mapping"),
    ],
)
def test_functions_that_go_wrong_are_named(
    role: str, function: Callable[[Any], Any], fragment: str
) -> None:
    problem = Problem("pond", program(), **{role: function})  # type: ignore[arg-type]
    use: dict[str, Callable[[], Any]] = {
        "sample": lambda: problem.sample_parameters(np.random.default_rng(0)),
        "features": lambda: problem.feature_vector(THETA),
        "start": lambda: problem.start_point(THETA, np.zeros(3)),
    }
    with pytest.raises(StatementError, match=fragment) as caught:
        use[role]()
    if function is raising:
        assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_no_sampler() -> None:
    with pytest.raises(StatementError, match="has no sampler"):
        Problem("pond", program()).sample_parameters(np.random.default_rng(0))


def test_a_form_that_no_method_holds() -> None:
    p = Program("cubic")
    x = p.continuous("x", (1,), 0, 1)
    p.between("cube", x**3, 0.1, 1.0)
    with pytest.raises(StatementError, match="problem 'cubic'"):
        Problem("cubic", p).instance({})


def test_a_checker_of_its_own_is_asked_by_name() -> None:
    problem = Problem(
        "pond", program(), check=lambda theta, values: {"dry": values["x"][0] - 1, "far": np.nan}
    )
    found = {b.name: b.residual for b in problem.own_residuals(THETA, np.array([1.5, 0, 0]))}
    assert found == {"own.dry": 0.5, "own.far": np.inf}
    assert Problem("pond", program()).own_residuals(THETA, np.zeros(3)) == ()
    strange = Problem("pond", program(), check=lambda theta, values: 3)
    with pytest.raises(StatementError, match="`check` must return a number by name"):
        strange.own_residuals(THETA, np.zeros(3))
    broken = Problem("pond", program(), check=lambda theta, values: values["y"])
    with pytest.raises(StatementError, match="`check` raised KeyError"):
        broken.own_residuals(THETA, np.zeros(3))
