"""Products of two variables: envelopes that narrow with the box of a node.

A product x y is a variable w of its own. Each node has a box for x and y, and the four half-spaces
of the product's envelope on it (McCormick 1976; eq. (8.26)): the narrower the box, the tighter.
A factor is an entity as integers are: its range is divided into cells so small that products in
one of them are exact for all purposes, and a node has a range of cells. So one tree branches on
integers and in space, and everything that it knows of nodes and bounds holds for both.

Rows of envelopes are written anew at each node whose box differs from the last one's; a working set
that is taken over from another node needs new factors, multipliers stay what they are: a guess
whose dual value is a bound.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_THIN = 1e-12  # length of a row that says nothing, relative to its entries
_ENDS = 0.15  # share of a range that a split leaves at either end
_MIDDLE = 0.25  # weight of the middle of a range beside the relaxation's value


class Spatial(NamedTuple):
    """K products of entities, and their rows; empty arrays where there are none."""

    first: IntArray  # (K,) entity of the first factor
    second: IntArray  # (K,) the same one for squares
    place: IntArray  # (K,) row that holds w
    begin: IntArray  # (K,) first of the four rows of its envelope
    vector: Array  # (K, 3, k) w, x and y over v
    base: Array  # (K, 3) and at w = 0
    weight: Array  # (K,) by how much a row may fail for each unit that w is off
    always: NDArray[np.uint8]  # (K,) whether a plain row holds it
    since: IntArray  # (K + 1,) where in the next two its conditional rows stand
    entity: IntArray  # integer that decides such a row
    value: IntArray  # and the value that has it
    left: Array  # (E,) of an entity in space: where its first cell begins
    cell: Array  # (E,) width of its cells, 0 for integers
    area: Array  # (K,) largest gap of the envelope on the first box
    last: Array  # (K, 4) the box that the rows are for


@compiled
def _end(p: Spatial, e: int, cells: Any, up: int) -> Any:
    """An end of an entity's range: of an integer its value, of a factor the edge of its cell."""
    if p.cell[e] == 0.0:
        return float(cells)
    return p.left[e] + p.cell[e] * (cells + up)


@compiled
def _place_envelopes(
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
    """Rows of all envelopes on a node's box; True if any of them is another one now."""
    moved = False
    k = len(u)
    for q in range(len(p.first)):
        i, j = p.first[q], p.second[q]
        a, b = _end(p, i, low[i], 0), _end(p, i, high[i], 1)
        c, d = _end(p, j, low[j], 0), _end(p, j, high[j], 1)
        last = p.last[q]
        if last[0] == a and last[1] == b and last[2] == c and last[3] == d:
            continue
        moved = True
        last[0], last[1], last[2], last[3] = a, b, c, d
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
            r = p.begin[q] + plane
            row = M[r]
            square, size, at = 0.0, 0.0, 0.0
            for h in range(k):
                entry = s * (w[h] - f * x[h] - g * y[h])
                size += w[h] * w[h] + (f * x[h]) ** 2 + (g * y[h]) ** 2
                row[h] = entry
                square += entry * entry
                at += entry * u[h]
            length = np.sqrt(square)
            if not length > _THIN * np.sqrt(size) or (i == j and plane == 3):
                on[r] = 0  # nothing that the box does not say, or said already
                continue
            base = s * (p.base[q, 0] - f * p.base[q, 1] - g * p.base[q, 2])
            for h in range(k):
                row[h] /= length
                T[h, r] = row[h]
            at /= length
            on[r] = 1
            norm[r] = length
            offset[r] = base - at * length
            lower[r] = -np.inf
            upper[r] = (-s * f * g - base) / length + at
            tolerance[r] = max(1e-9 / length, 1e-13)
    return moved


@compiled
def _wanted_split(p: Spatial, e: int, value: float, low: int, high: int) -> Any:
    """The last cell of the lower child of a factor's range."""
    begin, end = _end(p, e, low, 0), _end(p, e, high, 1)
    at = _MIDDLE * 0.5 * (begin + end) + (1.0 - _MIDDLE) * value
    room = _ENDS * (end - begin)
    at = min(max(at, begin + room), end - room)
    cell = np.int64(np.round((at - p.left[e]) / p.cell[e])) - 1
    return min(max(cell, low), high - 1)


@compiled
def _cell_of(p: Spatial, e: int, value: float, low: int, high: int) -> Any:
    """The cell of a range that a value falls in, or is nearest to."""
    cell = np.int64(np.floor((value - p.left[e]) / p.cell[e]))
    return min(max(cell, low), high)
