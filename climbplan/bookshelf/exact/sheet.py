"""Room for one node of the branch and bound: its books, the rows of its program, what is found.

Rows of small tables stand for books and for linear rows; their columns have names here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.pairs import box_row, highest, lowest
from climbplan.bookshelf.exact.problem import (
    FLAT,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    WIDTH,
    Problem,
    side_of,
)
from climbplan.bookshelf.exact.problem import REACH_HIGH as STATE_REACH_HIGH
from climbplan.bookshelf.exact.problem import REACH_LOW as STATE_REACH_LOW

# Columns of `Sheet.seat`; the first seven are the book's tilts as an angle box
MIDDLE, SIDE, REACH_LOW, REACH_HIGH = 7, 8, 9, 10
PATH = 11  # least distance from book 0
X, TILT = 12, 13  # the relaxed placement
POINT, POINT_SIDE = 14, 21  # the completed placement: an angle box without width, and its side
STATE_GAIN, TILT_GAIN = 22, 23  # what a decision promises [mm^2]
# Columns of `Sheet.role`
STATE, COLUMN = 0, 1  # -1: undecided; -1: the tilt is given
# Columns of `Sheet.pair`: a row's books
FIRST, SECOND = 0, 1
# Columns of `Sheet.side`: D, U or e in the middle of the tilts; right side; multiplier; and what
# the row says (numbers, because Numba compiles a function anew for each literal integer)
NUMBER, RHS, PRICE, KIND = 0, 1, 2, 3
APART, APART_BY_INSERTED, ORDER, LEFT, LEFT_BY_INSERTED = 0.0, 1.0, 2.0, 3.0, 4.0
RIGHT, RIGHT_BY_INSERTED, TOUCH, TOUCH_LEFT, TOUCH_RIGHT = 5.0, 6.0, 7.0, 8.0, 9.0
BOX, ALONE = 10.0, 11.0
# Columns of `Sheet.goal`
TARGET, WEIGHT = 0, 1


class Sheet(NamedTuple):
    """Room for the rows of one node and for what is found with them."""

    seat: Array  # (n + 1, columns) by book
    role: IntArray  # (n + 1, columns) by book
    rows: IntArray  # (1,) how many are used
    pair: IntArray  # (rows, columns)
    side: Array  # (rows, columns)
    C: Array  # (rows, variables)
    goal: Array  # (variables, columns)


def new_sheet(n: int) -> Sheet:
    """Room for scenes of n stored books."""
    rows, variables = n * n + 10 * n + 8, 2 * n
    return Sheet(
        seat=np.zeros((n + 1, 24)),
        role=np.zeros((n + 1, 2), np.int64),
        rows=np.zeros(1, np.int64),
        pair=np.zeros((rows, 2), np.int64),
        side=np.zeros((rows, 4)),
        C=np.zeros((rows, variables)),
        goal=np.zeros((variables, 2)),
    )


@compiled
def prepare(problem: Problem, sheet: Sheet, mask: IntArray, span: Array) -> int:
    """Boxes, sides, half widths and columns of a node; returns the number of variables."""
    n, book, seat, role = problem.stored, problem.book, sheet.seat, sheet.role
    columns = n
    for k in range(n + 1):
        state = -1
        low, high = np.inf, 0.0
        for s in range(4):
            if mask[k] >> s & 1:
                state = s if mask[k] == 1 << s else -1
                low = min(low, book[k, STATE_REACH_LOW + s])
                high = max(high, book[k, STATE_REACH_HIGH + s])
        role[k, STATE], role[k, COLUMN] = state, -1
        if state >= 0:
            from_tilt = to_tilt = math.pi / 2 if state == FLAT else 0.0
            if state == LEAN_LEFT or state == LEAN_RIGHT:
                from_tilt, to_tilt = span[k], span[n + k]
                if to_tilt > from_tilt:
                    role[k, COLUMN] = columns
                    columns += 1
            box_row(from_tilt, to_tilt, seat[k])
            seat[k, MIDDLE] = 0.5 * (from_tilt + to_tilt)
            seat[k, SIDE] = side_of(state)
            low = lowest(0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH], seat[k])
            high = highest(0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH], seat[k])
        seat[k, REACH_LOW], seat[k, REACH_HIGH] = low, high
    return columns
