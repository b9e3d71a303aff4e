"""The named blocks of a program, as stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from climbplan.arrays import Array
from climbplan.program.affine_array import AffineArray
from climbplan.program.polytope import Polytope


@dataclass(frozen=True)
class Variable:
    """A block of continuous variables, or of binaries."""

    name: str
    shape: tuple[int, ...]
    start: int  # first index in x
    lower: Array
    upper: Array
    unit: str
    integer: bool = False

    @property
    def stop(self) -> int:
        """One past the last index in x."""
        return self.start + math.prod(self.shape)


@dataclass(frozen=True)
class ImplicationBlock:
    """Rows for which binary == value implies lower <= expression <= upper."""

    name: str
    shape: tuple[int, ...]
    expression: list[Any]
    lower: Array
    upper: Array
    binary: list[Any]  # a stated binary for each entry
    value: bool
    unit: str


@dataclass(frozen=True)
class RowBlock:
    """Rows lower <= expression <= upper."""

    name: str
    shape: tuple[int, ...]
    expression: Sequence[Any] | AffineArray
    lower: Array
    upper: Array
    unit: str


@dataclass(frozen=True)
class SmoothBlock:
    """Rows lower <= expression <= upper, where the expression is any smooth function."""

    name: str
    shape: tuple[int, ...]
    expression: list[Any]
    lower: Array
    upper: Array
    unit: str


@dataclass(frozen=True)
class BallBlock:
    """Constraints || rows of expression || <= radius + slope."""

    name: str
    shape: tuple[int, ...]
    expression: Sequence[Any] | AffineArray  # K d scalars
    dimension: int
    radius: Array  # (K,)
    unit: str
    slope: Sequence[Any] | AffineArray | None = None  # K scalars, None for constant radii


@dataclass(frozen=True)
class ChoiceBlock:
    """Points, each of which lies in one of its alternatives."""

    name: str
    shape: tuple[int, ...]  # of the choices
    expression: Sequence[Any] | AffineArray
    dimension: int
    alternatives: tuple[tuple[Polytope, ...], ...]
    unit: str


@dataclass(frozen=True)
class Blocks:
    """All blocks of a program, in the order in which they were stated."""

    variables: tuple[Variable, ...]
    rows: tuple[RowBlock, ...]
    balls: tuple[BallBlock, ...]
    choices: tuple[ChoiceBlock, ...]
    implications: tuple[ImplicationBlock, ...]
    smooth: tuple[SmoothBlock, ...] = ()
