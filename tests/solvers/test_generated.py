"""Code generated from CasADi functions: every operation, layouts, refusals, when it is renewed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

import climbplan
from climbplan.solvers.generated import create_kernel

RNG = np.random.default_rng(3)


def caller(function: Any) -> Callable[[np.ndarray, np.ndarray], None]:
    """Compiled: one input, one output."""
    generated = create_kernel(lambda: function)

    @numba.njit
    def called(x: Any, y: Any) -> None:
        generated((x,), (y,))

    return called


@pytest.mark.parametrize(
    "operation",
    [
        lambda x, y: x + y,
        lambda x, y: x - y,
        lambda x, y: x * y,
        lambda x, y: x / y,
        lambda x, y: -x,
        lambda x, y: x * x,
        lambda x, y: 2 * x,
        lambda x, y: 1 / x,
        lambda x, y: x**y,
        lambda x, y: x**2.5,
        lambda x, y: ca.sqrt(x),
        lambda x, y: ca.exp(x),
        lambda x, y: ca.log(x),
        lambda x, y: ca.fabs(x - y),
        lambda x, y: ca.sin(x),
        lambda x, y: ca.cos(x),
        lambda x, y: ca.tan(x),
        lambda x, y: ca.asin(x),
        lambda x, y: ca.acos(x),
        lambda x, y: ca.atan(x),
        lambda x, y: ca.atan2(x - y, y),
        lambda x, y: ca.SX(0.1),
    ],
)
def test_each_operation_is_casadis(operation: Callable[[Any, Any], Any]) -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("one", [x], [operation(x[0], x[1])])
    called, found = caller(function), np.empty(1)
    for point in RNG.uniform(0.05, 0.95, (20, 2)):
        called(point, found)
        assert found[0] == pytest.approx(float(function(point)), rel=1e-14)


def test_jacobian_is_laid_out_column_by_column_with_its_zeros() -> None:
    x, a = ca.SX.sym("x", 5), ca.SX.sym("a")
    rows = ca.vertcat(ca.sin(x[0]) * x[3], a * x[1] ** 2, x[4] - x[0] * x[3])
    declared = ca.Function("rows", [a, x], [rows, ca.jacobian(rows, x)])
    assert declared.nnz_out(1) < 15
    generated = create_kernel(lambda: declared)

    @numba.njit
    def called(a: Any, x: Any, value: Any, slopes: Any) -> None:
        generated((a, x), (value, slopes))

    value, slopes, point = np.empty(3), np.full((5, 3), np.nan), RNG.normal(size=5)
    for number in (2.5, 2):  # whole numbers are numbers, too
        called(number, point, value, slopes)
        wanted = declared(number, point)
        np.testing.assert_allclose(value, np.array(wanted[0]).ravel(), rtol=1e-14)
        np.testing.assert_allclose(slopes.T, np.array(wanted[1]), rtol=1e-14)


def test_division_by_zero_follows_the_caller_as_in_numpy() -> None:
    x = ca.SX.sym("x")
    generated, y = create_kernel(lambda: ca.Function("inverse", [x], [1 / x])), np.empty(1)

    @numba.njit(error_model="numpy")
    def called(x: Any, y: Any) -> None:
        generated((x,), (y,))

    called(0.0, y)
    assert y[0] == np.inf


def test_arrays_of_other_sizes_are_refused_unwritten() -> None:
    x = ca.SX.sym("x", 3)
    called = caller(ca.Function("twice", [x], [2 * x]))
    y = np.zeros(3)
    for wrong in (2, 4):
        with pytest.raises(ValueError, match="twice: an array of 3 numbers was expected"):
            called(np.ones(wrong), y)
        with pytest.raises(ValueError, match="twice: an array of 3 numbers was expected"):
            called(np.ones(3), np.ones(wrong))
    assert (y == 0).all()
    called(np.ones(3), y)
    assert (y == 2).all()


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (np.ones(6)[::2], np.ones(3), "input 0 is array.*not a C-ordered"),
        (np.ones(3, np.float32), np.ones(3), "input 0 is array.*not a C-ordered"),
        (1.0, np.ones(3), "input 0 is float64, not a C-ordered"),
        (np.ones(3), np.ones(6)[::2], "output 0 is array.*not a C-ordered"),
        (np.ones(3), np.frombuffer(bytes(24)), "output 0 is .*not a C-ordered"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(x: Any, y: Any, message: str) -> None:
    symbol = ca.SX.sym("x", 3)
    called = caller(ca.Function("twice", [symbol], [2 * symbol]))
    with pytest.raises(NumbaError, match=message):
        called(x, y)


def test_functions_that_do_not_fit_are_refused() -> None:
    x = ca.SX.sym("x", 2)
    two = caller(ca.Function("two", [x], [x, x]))
    with pytest.raises(NumbaError, match="two has 1 inputs and 2 outputs, got 1 and 1"):
        two(np.ones(2), np.ones(2))
    sparse = ca.SX.sym("s", ca.Sparsity.lower(2))
    with pytest.raises(NumbaError, match="lower: input 0 is sparse"):
        caller(ca.Function("lower", [sparse], [ca.sum1(sparse)]))(np.ones(4), np.ones(2))
    matrix = ca.MX.sym("m", 2)
    with pytest.raises(NumbaError, match="call is not stated in scalars"):
        caller(ca.Function("call", [matrix], [2 * matrix]))(np.ones(2), np.ones(2))
    unknown = caller(ca.Function("bent", [x], [ca.erf(x)]))
    with pytest.raises(NumbaError, match="bent: no code is generated for CasADi's OP_ERF"):
        unknown(np.ones(2), np.ones(2))


STATED = "import casadi as ca\ndef stated(x):\n    return {factor} * ca.sin(x)\n"
ROOM = """
from pathlib import Path
import casadi as ca
import numpy as np
import stated
from climbplan.compiling import create_compiler
from climbplan.solvers.generated import create_kernel, hash_sources

def declare():
    print("declared")
    x = ca.SX.sym("x", 2)
    return ca.Function("f", [x], [stated.stated(x)])

sines = create_kernel(declare)

@create_compiler(Path(__file__).parent, "room.py", hash_sources(stated))
def called(x):
    y = np.empty(2)
    sines((x,), (y,))
    return y

print(called(np.array([0.0, np.pi / 2]))[1])
"""


def test_code_is_kept_until_what_it_is_generated_from_changes(tmp_path: Path) -> None:
    (tmp_path / "room.py").write_text(ROOM)
    package = str(Path(climbplan.__file__).parents[1])
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    said = []
    for factor in (2, 2, 3):
        (tmp_path / "stated.py").write_text(STATED.format(factor=factor))
        done = subprocess.run(
            [sys.executable, "room.py"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": package, **kept},
            capture_output=True,
            text=True,
            check=True,
        )
        said.append(done.stdout.split())
    assert said == [["declared", "2.0"], ["2.0"], ["declared", "3.0"]]
