"""What a search works on: rows, integers and cost in the coordinates of its nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.spatial import Spatial

ALWAYS, DECIDED, UNDECIDED = 0, 1, 2  # when a node has a row


class Numbers(NamedTuple):
    """Everything about the rows and integers that nodes do not change."""

    lower: Array  # (m,) of unit rows in v, at the centre of the beginning
    upper: Array
    norm: Array  # (m,) own unit by unit of v
    offset: Array  # (m,) value in the own unit at v = 0
    when: NDArray[np.int8]  # (m,) ALWAYS, DECIDED, UNDECIDED
    entity: IntArray  # (m,) integer that decides, -1
    value: IntArray  # (m,) of a decided integer that has the row
    share: Array  # (m,) of DECIDED rows: 1 / M, which makes violations comparable
    column: IntArray  # (E,) row that holds an entity's value, -1 for a switch
    first: IntArray  # (E + 1,) where in `rows_of` the conditional rows of an integer stand
    rows_of: IntArray
    group: IntArray  # (E,) exactly-one group, -1
    lowest: IntArray  # (E,) root's bounds
    highest: IntArray
    L: Array  # (k, k)
    U: Array  # (k, k) L'
    u: Array  # (k,)
    eps: Array  # (k,)
    center: Array  # (k,)
    box_lower: Array  # (k,) of w
    box_upper: Array
    H: Array  # (k, k)
    g: Array  # (k,)
    constant: float
    ceiling: float  # no point of the box costs more
    ball_rows: Array  # (B, D, k) |ball_rows w + ball| <= radius, zeros where a ball has fewer rows
    ball: Array  # (B, D)
    radius: Array  # (B,)
    spatial: Spatial  # products, whose factors are entities behind the integers


@dataclass(frozen=True)
class MixedIntegerProgram:
    """What a search works on, and the way back."""

    numbers: Numbers
    M: Array  # (m, k) unit rows
    T: Array  # (k, m)
    tolerance: Array  # (m,)
    X: Array  # (size, k) x = X w + start
    start: Array  # (size,)
    entities: IntArray  # the integers' places in x
    factors: IntArray  # those of factors of products, which are numbered behind them
    products: int  # place of the first product in x, the size where there are none
    key: IntArray  # (m,) what each row is, whatever the parameters: see `memory`
    lower: Array  # (size,) the box that bounds and rows leave
    upper: Array
    independent: IntArray  # (k,) places of w in x

    @property
    def size(self) -> int:
        """k."""
        return self.M.shape[1]

    def point(self, w: Array, low: IntArray) -> Array:
        """x (size,) at w with integers at `low` (E,)."""
        x = self.X @ w + self.start
        x[self.entities] = low[: len(self.entities)]
        return x


def with_room(numbers: Numbers, by: int) -> Numbers:
    """The same numbers with room for further rows."""
    if not by:
        return numbers
    names = ("lower", "upper", "norm", "offset", "when", "entity", "value", "share")
    parts: dict[str, Any] = {name: getattr(numbers, name) for name in names}
    parts = {name: np.concatenate([p, np.zeros(by, p.dtype)]) for name, p in parts.items()}
    return numbers._replace(**parts)


@dataclass(frozen=True)
class Impossible:
    """Why nothing is feasible, found before any search."""

    why: str
