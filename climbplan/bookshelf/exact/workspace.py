"""Workspace of one node of the branch and bound: books, rows of its program, and solution.

Rows of small tables stand for books and for linear rows; their columns have names here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.pairs import fill_angle_box, maximise_sinusoid, minimise_sinusoid
from climbplan.bookshelf.exact.problem import (
    FLAT,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    WIDTH,
    SceneArrays,
    select_side,
)
from climbplan.bookshelf.exact.problem import REACH_HIGH as STATE_REACH_HIGH
from climbplan.bookshelf.exact.problem import REACH_LOW as STATE_REACH_LOW

# Columns of `NodeWorkspace.body`; the first seven are the book's tilts as an angle box
MIDDLE, SIDE, REACH_LOW, REACH_HIGH = 7, 8, 9, 10
PATH = 11  # least distance from book 0
X, TILT = 12, 13  # the relaxed placement
POINT, POINT_SIDE = 14, 21  # the completed placement: an angle box without width, and its side
STATE_GAIN, TILT_GAIN = 22, 23  # what a decision promises [mm^2]
# Columns of `NodeWorkspace.role`
STATE, COLUMN = 0, 1  # -1: undecided; -1: the tilt is given
# Columns of `NodeWorkspace.pair`: a row's books
FIRST, SECOND = 0, 1
# Columns of `NodeWorkspace.side`: D, U or e in the middle of the tilts; right side; multiplier;
# and the kind of the row (floats, as Numba compiles a function again for each literal integer)
NUMBER, RHS, MULTIPLIER, KIND = 0, 1, 2, 3
APART, APART_BY_INSERTED, ORDER, LEFT, LEFT_BY_INSERTED = 0.0, 1.0, 2.0, 3.0, 4.0
RIGHT, RIGHT_BY_INSERTED, TOUCH, TOUCH_LEFT, TOUCH_RIGHT = 5.0, 6.0, 7.0, 8.0, 9.0
BOX, ALONE = 10.0, 11.0
# Columns of `NodeWorkspace.objective`
TARGET, WEIGHT = 0, 1


class NodeWorkspace(NamedTuple):
    """Scratch arrays for the books, the rows and the solution of one node."""

    body: Array  # (n + 1, columns) by book
    role: IntArray  # (n + 1, columns) by book
    rows: IntArray  # (1,) how many are used
    pair: IntArray  # (rows, columns)
    side: Array  # (rows, columns)
    C: Array  # (rows, variables)
    objective: Array  # (variables, columns)


def create_workspace(n: int) -> NodeWorkspace:
    """Create the workspace for scenes of n stored books."""
    rows, variables = n * n + 10 * n + 8, 2 * n
    return NodeWorkspace(
        body=np.zeros((n + 1, 24)),
        role=np.zeros((n + 1, 2), np.int64),
        rows=np.zeros(1, np.int64),
        pair=np.zeros((rows, 2), np.int64),
        side=np.zeros((rows, 4)),
        C=np.zeros((rows, variables)),
        objective=np.zeros((variables, 2)),
    )


@compiled
def prepare_node(problem: SceneArrays, work: NodeWorkspace, mask: IntArray, span: Array) -> int:
    """Prepare boxes, sides, half widths and columns of a node; returns the number of variables."""
    n, book, body, role = problem.stored, problem.book, work.body, work.role
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
            fill_angle_box(from_tilt, to_tilt, body[k])
            body[k, MIDDLE] = 0.5 * (from_tilt + to_tilt)
            body[k, SIDE] = select_side(state)
            low = minimise_sinusoid(0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH], body[k])
            high = maximise_sinusoid(0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH], body[k])
        body[k, REACH_LOW], body[k, REACH_HIGH] = low, high
    return columns
