"""McCormick envelopes of products of two variables on the boxes of nodes.

A product x y is a variable w of its own. Each node has a box for x and y, and the four half-spaces
of the product's envelope on it (McCormick 1976; eq. (8.26)); they tighten with the box. A factor is
an entity like an integer: its range is divided into cells so small that products are exact within
one of them for all purposes, and a node has a range of cells. One tree therefore branches on
integers and in space, and its bounds hold for both.

The rows of envelopes are rewritten at each node whose box differs from the previous one. A working
set from another node then needs new factors. Its multipliers remain dual feasible, so their dual
value is still a bound.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_THIN = 1e-12  # length below which a row is redundant, relative to its entries
_ENDS = 0.15  # fraction of a range that a split leaves at either end
_MIDDLE = 0.25  # weight of the midpoint against the relaxation's value in a split


class Spatial(NamedTuple):
    """The K products of entities, and their rows; arrays are empty where there are none."""

    first: IntArray  # (K,) entity of the first factor
    second: IntArray  # (K,) the same one for squares
    product_row: IntArray  # (K,) row whose value is w
    envelope_row: IntArray  # (K,) first of the four rows of the envelope
    vector: Array  # (K, 3, k) coefficients of w, x and y over v
    base: Array  # (K, 3) values of w, x and y at w = 0
    weight: Array  # (K,) largest violation of a row for each unit of error of w
    is_unconditional: NDArray[np.uint8]  # (K,) whether the product occurs in a plain row
    indicator_start: IntArray  # (K + 1,) begin of each product's indicator rows in the next two
    entity: IntArray  # integer that activates such a row
    value: IntArray  # value of the integer at which it is active
    left: Array  # (E,) begin of the first cell of a factor
    cell_width: Array  # (E,) width of a factor's cells, 0 for integers
    max_gap: Array  # (K,) largest gap of the envelope on the root's box
    last_box: Array  # (K, 4) box for which the rows were written


@compiled
def _find_range_end(p: Spatial, e: int, cells: Any, up: int) -> Any:
    """Return an end of an entity's range: an integer's value or the edge of a factor's cell."""
    if p.cell_width[e] == 0.0:
        return float(cells)
    return p.left[e] + p.cell_width[e] * (cells + up)


@compiled
def _update_envelopes(
    p: Spatial,
    low: IntArray,
    high: IntArray,
    M: Array,
    T: Array,
    lower: Array,
    upper: Array,
    on: NDArray[np.uint8],
    tolerance: Array,
    norm: Array,
    offset: Array,
    u: Array,
) -> bool:
    """Write the rows of all envelopes on a node's box; return whether any of them has changed."""
    changed = False
    k = len(u)
    for q in range(len(p.first)):
        i, j = p.first[q], p.second[q]
        a, b = _find_range_end(p, i, low[i], 0), _find_range_end(p, i, high[i], 1)
        c, d = _find_range_end(p, j, low[j], 0), _find_range_end(p, j, high[j], 1)
        last_box = p.last_box[q]
        if last_box[0] == a and last_box[1] == b and last_box[2] == c and last_box[3] == d:
            continue
        changed = True
        last_box[0], last_box[1], last_box[2], last_box[3] = a, b, c, d
        w, x, y = p.vector[q, 0], p.vector[q, 1], p.vector[q, 2]
        for plane in range(4):
            # s w >= s (f x + g y - f g) with s = 1 below and -1 above
            f, g, s = c, a, -1.0
            if plane == 1:
                f, g = d, b
            elif plane == 2:
                f, g, s = c, b, 1.0
            elif plane == 3:
                f, g, s = d, a, 1.0
            r = p.envelope_row[q] + plane
            row = M[r]
            square, size, value_at_u = 0.0, 0.0, 0.0
            for h in range(k):
                entry = s * (w[h] - f * x[h] - g * y[h])
                size += w[h] * w[h] + (f * x[h]) ** 2 + (g * y[h]) ** 2
                row[h] = entry
                square += entry * entry
                value_at_u += entry * u[h]
            length = np.sqrt(square)
            if not length > _THIN * np.sqrt(size) or (i == j and plane == 3):
                on[r] = 0  # implied by the box, or equal to another plane
                continue
            base = s * (p.base[q, 0] - f * p.base[q, 1] - g * p.base[q, 2])
            for h in range(k):
                row[h] /= length
                T[h, r] = row[h]
            value_at_u /= length
            on[r] = 1
            norm[r] = length
            offset[r] = base - value_at_u * length
            lower[r] = -np.inf
            upper[r] = (-s * f * g - base) / length + value_at_u
            tolerance[r] = max(1e-9 / length, 1e-13)
    return changed


@compiled
def _choose_cell_split(p: Spatial, e: int, value: float, low: int, high: int) -> Any:
    """Return the last cell of the lower child of a factor's range."""
    begin, end = _find_range_end(p, e, low, 0), _find_range_end(p, e, high, 1)
    split_value = _MIDDLE * 0.5 * (begin + end) + (1.0 - _MIDDLE) * value
    min_distance = _ENDS * (end - begin)
    split_value = min(max(split_value, begin + min_distance), end - min_distance)
    cell = np.int64(np.round((split_value - p.left[e]) / p.cell_width[e])) - 1
    return min(max(cell, low), high - 1)


@compiled
def _locate_cell(p: Spatial, e: int, value: float, low: int, high: int) -> Any:
    """Return the cell of a range that contains a value, or is nearest to it."""
    cell = np.int64(np.floor((value - p.left[e]) / p.cell_width[e]))
    return min(max(cell, low), high)
