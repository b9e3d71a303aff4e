"""Named matrices behind one another in a vector: how compiled programs lay their numbers out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import casadi as ca
import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class Layout:
    """Named matrices, each in column-major order, as CasADi has them."""

    shapes: tuple[tuple[str, tuple[int, int]], ...]

    @classmethod
    def of(cls, shapes: Mapping[str, tuple[int, int]]) -> Self:
        """One matrix after another."""
        return cls(tuple(shapes.items()))

    @property
    def size(self) -> int:
        """Length of the vector."""
        return sum(rows * columns for _, (rows, columns) in self.shapes)

    @property
    def names(self) -> tuple[str, ...]:
        """In order."""
        return tuple(name for name, _ in self.shapes)

    def place(self, wanted: str) -> slice:
        """Where a matrix is in the vector; raises KeyError for an unknown one."""
        at = 0
        for name, (rows, columns) in self.shapes:
            if name == wanted:
                return slice(at, at + rows * columns)
            at += rows * columns
        raise KeyError(wanted)

    def symbols(self) -> dict[str, Any]:
        """Fresh CasADi symbols."""
        return {name: ca.SX.sym(name, *shape) for name, shape in self.shapes}

    def split(self, vector: Any) -> dict[str, Any]:
        """The matrices in a vector of symbols."""
        return {name: ca.reshape(vector[self.place(name)], *shape) for name, shape in self.shapes}

    def pack(self, values: Mapping[str, Array]) -> Array:
        """Vectors (..., size) of arrays (..., *shape), or of any that broadcast to these."""
        batch = np.broadcast_shapes(*(np.shape(values[name])[:-2] for name in self.names))
        full = (np.broadcast_to(values[name], (*batch, *shape)) for name, shape in self.shapes)
        columns = [np.swapaxes(part, -1, -2).reshape(*batch, -1) for part in full]
        return np.concatenate(columns, axis=-1)

    def unpack(self, vectors: Array) -> dict[str, Array]:
        """Arrays (..., *shape) from vectors (..., size)."""
        parts, at = {}, 0
        for name, (rows, columns) in self.shapes:
            piece = vectors[..., at : at + rows * columns]
            parts[name] = np.swapaxes(piece.reshape(*piece.shape[:-1], columns, rows), -1, -2)
            at += rows * columns
        return parts
