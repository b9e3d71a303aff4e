"""Layout of named matrices in one vector, for the parameters of compiled programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import casadi as ca
import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class MatrixLayout:
    """Named matrices one after the other, each in column-major order as in CasADi."""

    shapes: tuple[tuple[str, tuple[int, int]], ...]

    @classmethod
    def of(cls, shapes: Mapping[str, tuple[int, int]]) -> Self:
        """Lay out one matrix after another."""
        return cls(tuple(shapes.items()))

    @property
    def size(self) -> int:
        """Length of the vector."""
        return sum(rows * columns for _, (rows, columns) in self.shapes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(name for name, _ in self.shapes)

    def place(self, requested: str) -> slice:
        """Return the slice of a matrix in the vector.

        Raises:
            KeyError: The name is unknown.
        """
        begin = 0
        for name, (rows, columns) in self.shapes:
            if name == requested:
                return slice(begin, begin + rows * columns)
            begin += rows * columns
        raise KeyError(requested)

    def symbols(self) -> dict[str, Any]:
        """Create CasADi symbols."""
        return {name: ca.SX.sym(name, *shape) for name, shape in self.shapes}

    def split(self, vector: Any) -> dict[str, Any]:
        """Return the matrices in a vector of symbols."""
        return {name: ca.reshape(vector[self.place(name)], *shape) for name, shape in self.shapes}

    def pack(self, values: Mapping[str, Array]) -> Array:
        """Return vectors (..., size) of arrays that broadcast to (..., *shape)."""
        batch = np.broadcast_shapes(*(np.shape(values[name])[:-2] for name in self.names))
        full = (np.broadcast_to(values[name], (*batch, *shape)) for name, shape in self.shapes)
        columns = [np.swapaxes(array, -1, -2).reshape(*batch, -1) for array in full]
        return np.concatenate(columns, axis=-1)

    def unpack(self, vectors: Array) -> dict[str, Array]:
        """Return arrays (..., *shape) from vectors (..., size)."""
        matrices, begin = {}, 0
        for name, (rows, columns) in self.shapes:
            entries = vectors[..., begin : begin + rows * columns]
            matrices[name] = np.swapaxes(
                entries.reshape(*entries.shape[:-1], columns, rows), -1, -2
            )
            begin += rows * columns
        return matrices
