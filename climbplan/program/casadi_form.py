"""Nonlinear programs of CasADi as programs: `Program.from_casadi`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array
from climbplan.errors import UsageError


def state_casadi_problem(
    program: Any,
    nlp: Mapping[str, Any],
    *,
    lbx: ArrayLike = -np.inf,
    ubx: ArrayLike = np.inf,
    lbg: ArrayLike = -np.inf,
    ubg: ArrayLike = np.inf,
    discrete: Sequence[bool] | None = None,
) -> None:
    """State minimise f(x, p) subject to lbx <= x <= ubx and lbg <= g(x, p) <= ubg.

    Each entry of x is a variable `x<i>`, parameters are `p`. Rows are `g`, those beyond products of
    two variables `g_smooth`. A cost that is not quadratic becomes the variable `cost`.

    Args:
        program: An empty `Program`, which states the problem afterwards.
        nlp: Symbols "x" and optionally "p", expressions "f" and optionally "g", all SX or all MX.
        lbx: (n,) lower bounds, or one for all.
        ubx: (n,) upper bounds.
        lbg: (m,) lower ends of rows.
        ubg: (m,) upper ends of rows.
        discrete: (n,) mask of integer variables, which need finite bounds.

    Raises:
        UsageError: A size does not fit, an expression is missing or has symbols that are in
            neither x nor p, bounds cross or are NaN, or an integer has no bounds.
    """
    if not isinstance(nlp, Mapping):
        raise UsageError(f"from_casadi: expected a dict with x and f, got {type(nlp).__name__}")
    if missing := [key for key in ("x", "f") if key not in nlp]:
        raise UsageError(f"from_casadi: {' and '.join(missing)} expected among {sorted(nlp)}")
    n, m = nlp["x"].numel(), nlp["g"].numel() if "g" in nlp else 0
    _check_expressions(nlp)
    lower, upper = _fit("lbx", lbx, n), _fit("ubx", ubx, n)
    if (crossing := ~(lower <= upper)).any():
        i = int(crossing.argmax())
        raise UsageError(
            f"from_casadi: x[{i}]: lbx <= ubx expected, got {lower[i]:g} and {upper[i]:g}"
        )
    integer = np.zeros(n, bool) if discrete is None else _fit("discrete", discrete, n) > 0
    variables = [_state_variable(program, i, lower[i], upper[i], integer[i]) for i in range(n)]
    x = ca.vertcat(*variables)
    inputs, arguments = [nlp["x"]], [x]
    if "p" in nlp and nlp["p"].numel():
        inputs.append(nlp["p"])
        arguments.append(ca.vertcat(*program.parameter("p", (nlp["p"].numel(),)).tolist()))
    outputs = [nlp["f"]] + ([nlp["g"]] if m else [])
    cost, *rows = ca.Function("nlp", inputs, outputs).call(arguments)
    _state_cost(program, cost, x)
    if m:
        _state_rows(
            program, ca.vec(ca.densify(rows[0])), x, _fit("lbg", lbg, m), _fit("ubg", ubg, m)
        )


def _check_expressions(nlp: Mapping[str, Any]) -> None:
    """Check that the cost is a scalar, and that expressions depend on x and p only.

    Raises:
        UsageError: They do not.
    """
    if nlp["f"].numel() != 1:
        raise UsageError(f"from_casadi: f: a scalar expected, got {nlp['f'].numel()} entries")
    declared = ca.vertcat(*(ca.vec(nlp[key]) for key in ("x", "p") if key in nlp))
    for key in ("f", "g"):
        if key not in nlp:
            continue
        declared_names = {s.name() for s in ca.symvar(declared)}
        free = [s.name() for s in ca.symvar(nlp[key]) if s.name() not in declared_names]
        if free:
            raise UsageError(f"from_casadi: {key}: symbol {free[0]!r} is in neither x nor p")


def _state_variable(program: Any, i: int, lower: float, upper: float, integer: bool) -> Any:
    """State one variable and return its symbol.

    Raises:
        UsageError: It is an integer without bounds.
    """
    if not integer:
        return program.continuous(f"x{i}", (1,), lower, upper)[0]
    if not np.isfinite([lower, upper]).all():
        raise UsageError(f"from_casadi: integer variable x{i} has no bounds: give lbx and ubx")
    return program.integer(f"x{i}", (1,), np.ceil(lower), np.floor(upper))[0]


def _state_cost(program: Any, cost: Any, x: Any) -> None:
    """State the cost, through a variable of its own where it is not quadratic."""
    if _is_quadratic(cost, x):
        program.minimise("f", np.array(cost.elements(), object)[0])
        return
    height = program.continuous("cost", (1,))
    program.smooth("f", np.array([cost.elements()[0] - height[0]], object), -np.inf, 0.0)
    program.minimise("f", height[0])


def _is_quadratic(expression: Any, x: Any) -> bool:
    """Return whether a scalar is a polynomial of degree 2 at most in x."""
    return not ca.depends_on(ca.hessian(expression, x)[0], x)


def _state_rows(program: Any, rows: Any, x: Any, lower: Array, upper: Array) -> None:
    """State rows by their degree."""
    entries = np.array(rows.elements(), object)
    is_bilinear = np.array([_is_quadratic(entry, x) for entry in entries])
    for name, state, mask in (
        ("g", program.between, is_bilinear),
        ("g_smooth", program.smooth, ~is_bilinear),
    ):
        if mask.any():
            state(name, entries[mask], lower[mask], upper[mask])


def _fit(name: str, values: Any, size: int) -> Array:
    """Return values as (size,).

    Raises:
        UsageError: They do not fit.
    """
    try:
        array = np.asarray(values, float).ravel()
    except (TypeError, ValueError):
        raise UsageError(f"from_casadi: {name}: numbers expected, got {values!r}") from None
    if array.size not in (1, size):
        raise UsageError(f"from_casadi: {name}: 1 or {size} numbers expected, got {array.size}")
    return np.broadcast_to(array, (size,)).astype(float)
