"""Scalars of a stated program, which NumPy treats as numbers.

A CasADi scalar times a NumPy array is a CasADi matrix. A `Scalar` times an array is an array of
scalars, of the shape that NumPy's broadcasting gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

# Methods that NumPy calls on the entries of object arrays: np.sin(x) calls x.sin()
_FUNCTIONS = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("arcsinh", "arccosh", "arctanh", "exp", "expm1", "log", "log1p", "log10", "sqrt"),
    *("fabs", "sign", "erf", "__neg__", "__pos__"),
)
_OPERATORS = (
    ("add", ca.plus, np.add),
    ("sub", ca.minus, np.subtract),
    ("mul", ca.times, np.multiply),
    ("truediv", ca.rdivide, np.divide),
    ("pow", ca.power, np.power),
)


class Scalar(ca.SX):
    """A variable, a parameter, or an expression of them, for CasADi and NumPy."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Apply a function of NumPy entry by entry, as for arrays of scalars."""
        if len(inputs) == 1 or any(isinstance(value, np.ndarray) for value in inputs):
            boxed = [_wrap_scalar(value) if isinstance(value, ca.SX) else value for value in inputs]
            return getattr(ufunc, method)(*boxed, **options)
        return as_scalar(super().__array_ufunc__(ufunc, method, *inputs, **options))


def as_scalar(value: Any) -> Any:
    """Return a CasADi expression as a `Scalar` if it is 1 by 1, anything else as it is."""
    if type(value) is ca.SX and value.numel() == 1:
        value.__class__ = Scalar
    return value


def scalars(values: Iterable[Any]) -> NDArray[np.object_]:
    """Return CasADi scalars as an array (n,) of `Scalar`."""
    return object_array([as_scalar(value) for value in values])


def object_array(values: list[Any]) -> NDArray[np.object_]:
    """Return values as an array (n,) of objects, whatever sequences they might be read as."""
    array = np.empty(len(values), dtype=object)
    for index, value in enumerate(values):
        array[index] = value
    return array


def entries_of(owner: str, expression: Any) -> NDArray[np.object_]:
    """Return the scalars of an expression in an array of its shape.

    Args:
        owner: Whose expression it is, as messages name it.
        expression: An array or nested lists of scalars, one scalar (then the array has no
            dimensions), or a CasADi matrix. A column of CasADi is a vector (n,), as CasADi has
            no other.

    Raises:
        ValueError: If an entry is no scalar, or lists have no common shape.
    """
    if isinstance(expression, ca.SX):
        rows, columns = expression.shape
        if (rows, columns) == (1, 1):
            return _wrap_scalar(expression)
        dense = scalars(ca.densify(expression.T).elements())  # CasADi goes column by column
        return dense if columns == 1 else dense.reshape(rows, columns)
    if isinstance(expression, list | tuple):
        expression = _stack_lists(owner, expression)
    array = expression if isinstance(expression, np.ndarray) else _wrap_scalar(expression)
    for index, entry in np.ndenumerate(array):
        if isinstance(entry, ca.SX) and entry.numel() != 1:
            rows, columns = entry.shape
            raise ValueError(
                f"{owner}: a scalar expected at {list(index)}, got a {rows} by {columns} matrix of "
                "CasADi; write its entries into the array one by one"
            )
    return array


def _stack_lists(owner: str, values: list[Any] | tuple[Any, ...]) -> NDArray[np.object_]:
    """Stack nested lists of scalars."""
    arrays = [entries_of(owner, value) for value in values]
    shapes = {array.shape for array in arrays}
    if len(shapes) > 1:
        shape_list = ", ".join(map(str, sorted(shapes)))
        raise ValueError(
            f"{owner}: entries of one shape expected in a list, got shapes {shape_list}"
        )
    return np.stack(arrays) if arrays else np.empty(0, dtype=object)


def _wrap_scalar(value: Any) -> NDArray[np.object_]:
    """Return an array of no dimensions with a value in it."""
    box = np.empty((), dtype=object)
    box[()] = value
    return box


def _create_operator(
    function: Callable[[Any, Any], Any], ufunc: Any, swapped: bool
) -> Callable[..., Any]:
    """Create an operator that leaves arrays to NumPy, and returns a `Scalar` for scalars.

    `swapped` means that the scalar is the second operand.
    """

    def apply(self: Scalar, other: Any) -> Any:
        if isinstance(other, np.ndarray | list | tuple):
            array = np.asarray(other)
            return ufunc(array, self) if swapped else ufunc(self, array)
        return as_scalar(function(other, self) if swapped else function(self, other))

    return apply


def _create_function(name: str) -> Callable[..., Any]:
    """Create a function of one scalar."""
    casadi_function = getattr(ca.SX, name)

    def apply(self: Scalar) -> Any:
        return as_scalar(casadi_function(self))

    return apply


for _name, _own, _ufunc in _OPERATORS:
    setattr(Scalar, f"__{_name}__", _create_operator(_own, _ufunc, swapped=False))
    setattr(Scalar, f"__i{_name}__", _create_operator(_own, _ufunc, swapped=False))
    setattr(Scalar, f"__r{_name}__", _create_operator(_own, _ufunc, swapped=True))
setattr(Scalar, "arctan2", _create_operator(ca.atan2, np.arctan2, swapped=False))  # noqa: B010
for _name in _FUNCTIONS:
    setattr(Scalar, _name, _create_function(_name))
setattr(Scalar, "__abs__", _create_function("fabs"))  # noqa: B010  # CasADi has it from 3.8 on
