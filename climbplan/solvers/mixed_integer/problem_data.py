"""Problem data of a search: rows, integers and cost in the coordinates of its nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.spatial import Spatial

# When a row is active at a node: always, once its integer has a given value, or until it is fixed
ALWAYS, DECIDED, UNDECIDED = 0, 1, 2


class ProblemData(NamedTuple):
    """Rows, integers and cost of a search, which its nodes do not change."""

    lower: Array  # (m,) bounds of unit rows in v, at the initial proximal center
    upper: Array
    norm: Array  # (m,) length of a row: unit of the stated row by unit of v
    offset: Array  # (m,) value of the stated row at v = 0
    activation: NDArray[np.int8]  # (m,) ALWAYS, DECIDED, UNDECIDED
    entity: IntArray  # (m,) integer that activates the row, -1 for none
    value: IntArray  # (m,) value of the integer at which a DECIDED row is active
    inverse_big_m: Array  # (m,) 1 / M of DECIDED rows, which makes violations comparable
    value_row: IntArray  # (E,) row whose value is that of the entity, -1 for a switch
    indicator_start: IntArray  # (E + 1,) begin of each integer's rows in `indicator_rows`
    indicator_rows: IntArray
    group: IntArray  # (E,) exactly-one group, -1 for none
    root_low: IntArray  # (E,) bounds at the root
    root_high: IntArray
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
    max_cost: float  # upper bound on the cost over the box
    ball_rows: Array  # (B, D, k) |ball_rows w + ball| <= radius + slope w, padded with zeros
    ball: Array  # (B, D)
    radius: Array  # (B,)
    slope: Array  # (B, k)
    spatial: Spatial  # products; their factors are entities numbered after the integers


@dataclass(frozen=True)
class MixedIntegerProgram:
    """Problem data of a search, and the map from its coordinates back to x."""

    data: ProblemData
    M: Array  # (m, k) unit rows
    T: Array  # (k, m)
    tolerance: Array  # (m,)
    X: Array  # (size, k) x = X w + start
    start: Array  # (size,)
    entities: IntArray  # (E,) indices of the integers in x
    factors: IntArray  # (F,) indices of the factors of products, numbered after the integers
    products: int  # index of the first product in x, the size where there are none
    row_key: IntArray  # (m,) identity of each row, independent of parameters (`row_keys`)
    lower: Array  # (size,) box after bound propagation
    upper: Array
    independent: IntArray  # (k,) indices of w in x
    zero_cost: float  # `compute_zero_cost` of the instance

    @property
    def size(self) -> int:
        """Number of independent variables k."""
        return self.M.shape[1]

    def recover_point(self, w: Array, low: IntArray) -> Array:
        """Return x (size,) at w with the integers at `low` (E,)."""
        x = self.X @ w + self.start
        x[self.entities] = low[: len(self.entities)]
        return x


def extend_rows(data: ProblemData, num_rows: int) -> ProblemData:
    """Return the same data with capacity for further rows."""
    if not num_rows:
        return data
    fields = ("lower", "upper", "norm", "offset", "activation", "entity", "value", "inverse_big_m")
    extended: dict[str, Any] = {name: getattr(data, name) for name in fields}
    extended = {
        name: np.concatenate([array, np.zeros(num_rows, array.dtype)])
        for name, array in extended.items()
    }
    return data._replace(**extended)


@dataclass(frozen=True)
class ProvedInfeasible:
    """Report that presolve has proved infeasibility, and why."""

    why: str
