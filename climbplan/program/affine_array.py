"""Arrays of affine expressions with numeric coefficients, for blocks without parameters.

They are written like the arrays of scalars of a program's variables, but stated in milliseconds:
every operation is one on sparse matrices instead of one on each scalar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from climbplan.arrays import Array


@dataclass(frozen=True)
class Quadratic:
    """Quadratic function 1/2 x'Px + q'x + constant."""

    P: sparse.csr_matrix  # (n, n)
    q: Array  # (n,)
    constant: float

    def __rmul__(self, weight: float) -> Quadratic:
        return Quadratic(weight * self.P, weight * self.q, float(weight * self.constant))


class AffineArray:
    """Array with entries matrix[index] x + constant[index], of the shape of `index`.

    The matrix is (p, n). Numbers may be on either side of +, - and *, and on the right of @.
    NumPy's concatenate, stack, diff and broadcast_to are supported.
    """

    __array_ufunc__ = None  # leaves `numbers - this` to the operators below

    def __init__(self, matrix: sparse.csr_matrix, constant: Array, index: NDArray[np.intp]) -> None:
        self._matrix, self._constant, self._index = matrix, constant, index

    @classmethod
    def variables(cls, start: int, shape: tuple[int, ...], count: int) -> AffineArray:
        """Return a block of variables that begins at `start` among `count`."""
        size = int(np.prod(shape))
        positions = (np.arange(size), start + np.arange(size))
        matrix = sparse.csr_matrix((np.ones(size), positions), shape=(size, count))
        return cls(matrix, np.zeros(size), np.arange(size).reshape(shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return self._index.shape

    @property
    def coefficients(self) -> sparse.csr_matrix:
        """Coefficients (size, n), entries in C order."""
        return self._matrix[self._index.ravel()]

    @property
    def constants(self) -> Array:
        """Constants (size,)."""
        return self._constant[self._index.ravel()]

    def ravel(self) -> AffineArray:
        """Return all entries in one row."""
        return AffineArray(self._matrix, self._constant, self._index.ravel())

    def __len__(self) -> int:
        return len(self._index)

    def __getitem__(self, key: Any) -> AffineArray:
        return AffineArray(self._matrix, self._constant, np.asarray(self._index[key]))

    def __add__(self, other: Any) -> AffineArray:
        return self._add(other, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> AffineArray:
        return self._add(other, -1.0)

    def __rsub__(self, other: Any) -> AffineArray:
        return (-1.0 * self)._add(other, 1.0)

    def __mul__(self, factor: ArrayLike) -> AffineArray:
        index, factors = np.broadcast_arrays(self._index, np.asarray(factor, np.float64))
        flat, weight = index.ravel(), factors.ravel()
        matrix = sparse.diags(weight).tocsr() @ self._matrix[flat]
        return _create_array(matrix, weight * self._constant[flat], index.shape)

    __rmul__ = __mul__

    def __matmul__(self, numbers: Array) -> AffineArray:
        """Multiply along the last axis by a matrix of numbers (d, k)."""
        return self.along(numbers)

    def along(self, matrices: Array) -> AffineArray:
        """Return products (..., k) of the vectors (..., d) with matrices (..., d, k), broadcast."""
        d, k = matrices.shape[-2:]
        shape = np.broadcast_shapes(self.shape[:-1], matrices.shape[:-2])
        index = np.broadcast_to(self._index[..., None, :], (*shape, k, d)).ravel()
        weight = np.broadcast_to(np.swapaxes(matrices, -1, -2), (*shape, k, d)).ravel()
        count = len(index) // d
        mixing = sparse.csr_matrix(
            (weight, index, d * np.arange(count + 1)), shape=(count, self._matrix.shape[0])
        )
        return _create_array(mixing @ self._matrix, mixing @ self._constant, (*shape, k))

    def sum_of_squares(self) -> Quadratic:
        """Return the sum of the squares of all entries."""
        M, c = self.coefficients, self.constants
        return Quadratic((2.0 * (M.T @ M)).tocsr(), 2.0 * (M.T @ c), float(c @ c))

    def __array_function__(
        self, function: Any, types: Any, arguments: Sequence[Any], options: dict[str, Any]
    ) -> Any:
        if function is np.concatenate or function is np.stack:
            return _join(function, *arguments, **options)
        if function is np.diff:
            axis = options.get("axis", -1)
            ahead = np.take(self._index, np.arange(1, self.shape[axis]), axis)
            behind = np.take(self._index, np.arange(self.shape[axis] - 1), axis)
            return self._index_entries(ahead) - self._index_entries(behind)
        if function is np.broadcast_to:
            return self._index_entries(np.broadcast_to(self._index, arguments[1]))
        return NotImplemented

    def _index_entries(self, index: NDArray[np.intp]) -> AffineArray:
        """Return the entries of an index."""
        return AffineArray(self._matrix, self._constant, index)

    def _add(self, operand: Any, sign: float) -> AffineArray:
        """Add or subtract numbers or another array."""
        if not isinstance(operand, AffineArray):
            index, numbers = np.broadcast_arrays(self._index, np.asarray(operand, np.float64))
            flat = index.ravel()
            constant = self._constant[flat] + sign * numbers.ravel()
            return _create_array(self._matrix[flat], constant, index.shape)
        own_index, other_index = np.broadcast_arrays(self._index, operand._index)
        own_flat, other_flat = own_index.ravel(), other_index.ravel()
        matrix = self._matrix[own_flat] + sign * operand._matrix[other_flat]
        return _create_array(
            matrix, self._constant[own_flat] + sign * operand._constant[other_flat], own_index.shape
        )


def _create_array(matrix: Any, constant: Array, shape: tuple[int, ...]) -> AffineArray:
    """Create an array of the rows of a matrix."""
    index = np.arange(len(constant)).reshape(shape)
    return AffineArray(sparse.csr_matrix(matrix), constant, index)


def _join(function: Any, arrays: Sequence[Any], axis: int = 0) -> AffineArray:
    """Concatenate or stack arrays; entries may be numbers."""
    width = next(p._matrix.shape[1] for p in arrays if isinstance(p, AffineArray))
    matrices, constants, indices = [], [], []
    count = 0
    for array in arrays:
        if isinstance(array, AffineArray):
            matrix, constant, index = array._matrix, array._constant, array._index
        else:
            numbers = np.asarray(array, np.float64)
            matrix = sparse.csr_matrix((numbers.size, width))
            constant = numbers.ravel()
            index = np.arange(numbers.size).reshape(numbers.shape)
        matrices.append(matrix)
        constants.append(constant)
        indices.append(index + count)
        count += len(constant)
    stacked = sparse.vstack(matrices).tocsr()
    return AffineArray(stacked, np.concatenate(constants), function(indices, axis=axis))
