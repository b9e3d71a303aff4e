"""Partitions of variables into pieces: intervals that may be disconnected or overlap.

A partition has one set of binaries, shared by all products in which its variables occur. It may
have several variables (the cosine and sine of one angle); its pieces are then boxes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.blocks import Variable

Encoding = Literal["unary", "log2"]
_TOUCHING = 1e-9  # relative gap below which pieces are adjacent


@dataclass(frozen=True)
class Partition:
    """N pieces of d variables; piece i is the box lower[i] <= x[variables] <= upper[i].

    `covering` asserts that every feasible point lies in a piece even if the pieces do not cover the
    variables' bounds (the arc of a unit circle in cosine and sine).
    """

    variables: IntArray  # (d,)
    lower: Array  # (N, d)
    upper: Array  # (N, d)
    covering: bool = False

    def __post_init__(self) -> None:
        d = len(self.variables)
        if self.lower.shape != self.upper.shape or self.lower.ndim != 2 or not len(self.lower):
            raise UsageError(f"partition of variables {self.variables}: pieces (N, {d}) expected")
        if self.lower.shape[1] != d:
            raise UsageError(f"partition of variables {self.variables}: pieces (N, {d}) expected")
        if not (np.isfinite(self.lower) & np.isfinite(self.upper)).all():
            raise UsageError(f"partition of variables {self.variables}: a piece is not bounded")
        if (self.lower > self.upper).any():
            raise UsageError(f"partition of variables {self.variables}: a piece ends too early")

    @property
    def count(self) -> int:
        """Number of pieces N."""
        return len(self.lower)

    def count_binaries(self, encoding: Encoding) -> int:
        """Return the number of binaries that select the piece."""
        if self.count == 1:
            return 0
        return self.count if encoding == "unary" else (self.count - 1).bit_length()

    def find_piece(self, x: Array) -> int:
        """Return the piece in which x (n,) lies deepest, or the nearest one."""
        y = x[self.variables]
        violation = np.maximum(self.lower - y, y - self.upper)
        return int(np.argmin(violation.max(axis=1)))

    def covers(self, low: Array, high: Array) -> bool:
        """Return whether every point of low <= x[variables] <= high lies in some piece."""
        if self.covering:
            return True
        if not (np.isfinite(low) & np.isfinite(high)).all():
            return False
        slack = _TOUCHING * np.maximum(1.0, high - low)
        axes = []
        for k in range(len(self.variables)):
            knots = np.concatenate([[low[k], high[k]], self.lower[:, k], self.upper[:, k]])
            knots = np.unique(np.clip(knots, low[k], high[k]))
            if len(knots) == 1:
                axes.append(knots)
                continue
            wide = np.diff(knots) > slack[k]
            axes.append((0.5 * (knots[1:] + knots[:-1]))[wide])
        mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        within = (mesh[:, None] >= self.lower - slack) & (mesh[:, None] <= self.upper + slack)
        return bool(np.all(np.any(np.all(within, axis=2), axis=1)))


def pieces(knots: ArrayLike, overlap: float = 0.0) -> Array:
    """Return intervals (N, 2) between increasing knots, widened by the overlap at both ends."""
    ends = np.asarray(knots, float)
    if ends.ndim != 1 or len(ends) < 2 or (np.diff(ends) <= 0).any():
        raise UsageError("knots must be at least two increasing numbers")
    return np.stack([ends[:-1] - overlap, ends[1:] + overlap], axis=1)


def uniform(lower: float, upper: float, count: int, overlap: float = 0.0) -> Array:
    """Return `count` equal pieces (count, 2) of an interval."""
    return pieces(np.linspace(lower, upper, count + 1), overlap)


def each(variable: Variable | Sequence[int], intervals: ArrayLike) -> tuple[Partition, ...]:
    """Return a partition with the same intervals (N, 2) for every entry of a block."""
    if isinstance(variable, Variable):
        variable = range(variable.start, variable.stop)
    ends = np.asarray(intervals, float).reshape(-1, 2)
    return tuple(Partition(np.array([i]), ends[:, :1], ends[:, 1:]) for i in variable)


def together(
    variables: Sequence[int], lower: ArrayLike, upper: ArrayLike, covering: bool = False
) -> Partition:
    """Return one partition of several variables into boxes (N, d)."""
    index = np.asarray(variables, np.int64)
    return Partition(index, np.asarray(lower, float), np.asarray(upper, float), covering)


def by_variable(grids: Mapping[int, ArrayLike]) -> tuple[Partition, ...]:
    """Return a partition for each variable index with its intervals (N, 2)."""
    return tuple(p for index, ends in grids.items() for p in each([index], ends))


def build_code(count: int) -> Array:
    """Return codes (N, ceil(log2 N)) of the pieces; the remaining codes belong to no piece."""
    bits = (count - 1).bit_length() if count > 1 else 0
    return np.array([[(i >> b) & 1 for b in range(bits)] for i in range(count)], float).reshape(
        count, bits
    )
