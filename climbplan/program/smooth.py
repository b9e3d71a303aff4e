"""Smooth blocks: rows that are neither affine nor products, such as rotations and kinematics.

A statement adds them by name (`Program.smooth`), as expressions or as one CasADi function mapped
over knots. Methods that support them differentiate one function of (x, theta) for all blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.blocks import SmoothBlock
from climbplan.program.scalar import scalars


@dataclass(frozen=True, eq=False)
class SmoothForm:
    """All smooth blocks of a program as one function, shared by its instances."""

    function: Any  # ca.Function (x (n,), theta (p,)) -> (m,)
    size: int  # n, variables of the statement
    count: int  # m

    @classmethod
    def of(
        cls, blocks: Sequence[SmoothBlock], x_symbols: Sequence[Any], theta_symbols: Sequence[Any]
    ) -> SmoothForm | None:
        """Build the form of a program's blocks, None without any."""
        if not blocks:
            return None
        x, theta = ca.vertcat(*x_symbols), ca.vertcat(*theta_symbols)
        rows = ca.vertcat(*(entry for block in blocks for entry in block.expression))
        function = ca.Function("smooth", [x, theta], [rows])
        return cls(function, len(x_symbols), int(rows.numel()))


@dataclass(frozen=True, eq=False)
class Smooth:
    """Rows lower <= g(x; theta) <= upper at one theta.

    x may have more variables after those of the statement, as reformulations add them.
    """

    form: SmoothForm
    theta: Array  # (p,)
    lower: Array  # (m,)
    upper: Array  # (m,)

    @property
    def count(self) -> int:
        """Number of rows m."""
        return self.form.count

    def values(self, x: Array) -> Array:
        """Return g (m,) at x."""
        return np.array(self.form.function(x[: self.form.size], self.theta)).ravel()

    def outside(self, x: Array) -> Array:
        """Return the violation of each row (m,); infinite where g is not a number."""
        value = self.values(x)
        violation = np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)
        return np.where(np.isnan(value), np.inf, violation)


def over_knots(function: Any, arguments: Sequence[Any]) -> Any:
    """Return (K, m) scalars: a CasADi function at each of K knots.

    Args:
        function: Function of vectors that returns one vector (m,).
        arguments: An array for each of its inputs, of shape (K, d), or (d,) where it is the same at
            all knots.

    Raises:
        ValueError: Shapes do not fit.
    """
    stacked = [np.asarray(argument, dtype=object) for argument in arguments]
    if function.n_in() != len(stacked) or function.n_out() != 1:
        raise ValueError(
            f"{function.name()} takes {function.n_in()} and returns {function.n_out()} vectors, "
            f"expected {len(stacked)} and one"
        )
    counts = {argument.shape[0] for argument in stacked if argument.ndim == 2}
    if len(counts) > 1 or any(argument.ndim not in (1, 2) for argument in stacked):
        shapes = ", ".join(str(argument.shape) for argument in stacked)
        raise ValueError(f"{function.name()}: shapes (K, d) or (d,) expected, got {shapes}")
    for number, argument in enumerate(stacked):
        if argument.shape[-1] != function.size1_in(number):
            raise ValueError(
                f"{function.name()}: argument {number} has {argument.shape[-1]} entries a knot, "
                f"expected {function.size1_in(number)}"
            )
    rows = []
    for k in range(next(iter(counts), 1)):
        columns = [ca.vertcat(*(a[k] if a.ndim == 2 else a)) for a in stacked]
        rows.append(scalars(function(*columns).elements()))
    return np.stack(rows)
