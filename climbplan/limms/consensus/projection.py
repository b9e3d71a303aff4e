"""The mixed-integer block with fixed integers: a projection, eq. (6.12a) as a conic program.

The program minimises the weighted squared distance to the target plus the linear cost, with link
lengths as second-order cones. Its norm is that of the nonlinear block, so the dual has one meaning
in both. In the L1 norm, a foot that stands still follows the median of its knots, however far the
last one is. The squared norm counts every distance.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.consensus.block_solution import BlockSolution, LocalCopy, decode_modes
from climbplan.limms.consensus.link_cuts import LENGTH_TOLERANCE
from climbplan.limms.consensus.mixed_integer import MixedIntegerBlock
from climbplan.limms.consensus.nonlinear import BOX_WEIGHT, POINT_WEIGHT
from climbplan.program.instance import Balls, Implications, Instance, Products
from climbplan.solvers.convex.clarabel import ClarabelSession

_ROW_TOLERANCE = 1e-9  # of rows that no point within the bounds violates


class Projection:
    """The block with the integers of one solution; free blocks of links come with each target."""

    def __init__(self, block: MixedIntegerBlock, x: Array) -> None:
        """Initialise with the integers of a solution x, whose distance to the goal is an upper
        bound.
        """
        self.problem, self.columns, self.rows = block.problem, block.columns, block.rows
        rows, c = block.rows, block.columns
        self._x = x.copy()
        self._num_columns = block.num_columns
        row_range = slice(0, block.num_rows)
        self._matrix = rows.matrix()[row_range, : self._num_columns].tocsc()
        self._row_lower, self._row_upper = rows.row_lower[row_range], rows.row_upper[row_range]
        self._cost = np.array(rows.cost)[: self._num_columns]
        self._lower, self._upper = (
            np.array(v, float)[: self._num_columns] for v in (rows.lower, rows.upper)
        )
        integers = np.flatnonzero(np.array(rows.integer)[: self._num_columns])
        self._lower[integers] = self._upper[integers] = np.round(x[integers])
        self._upper[c.goal_error] = x[c.goal_error] + 1e-6
        self._session = ClarabelSession()

    def solve(self, target: LocalCopy, weight: float, region: IntArray) -> BlockSolution:
        """Return the nearest solution to a target, links after the start in blocks (K + 1, L, 4).

        Where these blocks admit no solution, the previous ones are kept.
        """
        start_time = time.perf_counter()
        previous = self._x
        x = self._project(target, weight, self._apply_regions(region))
        if x is None:
            x = self._project(target, weight, previous[: self._num_columns])
        seconds = time.perf_counter() - start_time
        if x is None:
            return BlockSolution("infeasible", None, None, None, np.inf, seconds, None)
        c = self.columns
        self._x = np.concatenate([x, previous[self._num_columns :]])
        copy = LocalCopy(x[c.position], x[c.points])
        return BlockSolution(
            "optimal",
            copy,
            decode_modes(self.problem, c, self._x),
            x[c.velocity],
            float(np.linalg.norm(copy.box[-1] - self.problem.scene.goal)),
            seconds,
            self._x,
            self.rows.worst(self._x),
        )

    def _apply_regions(self, region: IntArray) -> Array:
        """Return the last solution with other free blocks."""
        x, columns = self._x[: self._num_columns].copy(), self.columns.region
        if len(columns):
            chosen = np.moveaxis(region[1:], 0, -1).swapaxes(0, 1)  # (4, L, K)
            x[columns[..., 1:]] = np.arange(len(columns))[:, None, None, None] == chosen
        return x

    def _project(self, target: LocalCopy, weight: float, x: Array) -> Array | None:
        """Return the projection with the free blocks of x, or None without a solution."""
        c = self.columns
        lower, upper = self._lower.copy(), self._upper.copy()
        region = c.region.ravel()
        lower[region] = upper[region] = np.round(x[region])
        free = lower < upper
        shift = self._matrix @ np.where(free, 0.0, lower)
        A = self._matrix[:, free].tocsr()
        keep = _select_binding_rows(
            A, self._row_lower - shift, self._row_upper - shift, lower[free], upper[free]
        )
        curvature = np.zeros(self._num_columns)
        desired = np.zeros(self._num_columns)
        for columns, values, block_weight in (
            (c.position, target.box, BOX_WEIGHT),
            (c.points, target.points, POINT_WEIGHT),
        ):
            curvature[columns], desired[columns] = 2 * weight * block_weight, values
        size = int(free.sum())
        no_rows, empty = sparse.csr_matrix((0, size)), np.zeros(0)
        instance = Instance(
            name="projection",
            P=sparse.diags(curvature[free]).tocsc(),
            q=(self._cost - curvature * desired)[free],
            constant=0.0,
            lower=lower[free],
            upper=upper[free],
            A=A[keep],
            row_lower=(self._row_lower - shift)[keep],
            row_upper=(self._row_upper - shift)[keep],
            balls=(self._build_link_balls(free, lower),),
            choices=(),
            integer=np.zeros(size, bool),
            products=Products(np.zeros(0, int), np.zeros(0, int)),
            Q=sparse.csr_matrix((len(keep), 0)),
            implications=Implications(
                no_rows,
                sparse.csr_matrix((0, 0)),
                empty,
                empty,
                np.zeros(0, int),
                np.zeros(0, bool),
            ),
        )
        answer = self._session.solve(instance)
        if answer.x is None:
            return None
        solution = lower.copy()
        solution[free] = answer.x
        return solution

    def _build_link_balls(self, free: BoolArray, fixed: Array) -> Balls:
        """Return the length constraints of links after the start."""
        points = self.columns.points[1:]
        link_ends = points[..., 1:, :].reshape(-1, 3), points[..., :-1, :].reshape(-1, 3)
        count = 3 * len(link_ends[0])
        row = np.arange(count)
        F = sparse.csr_matrix(
            (np.ones(count), (row, link_ends[0].ravel())), shape=(count, self._num_columns)
        ) - sparse.csr_matrix(
            (np.ones(count), (row, link_ends[1].ravel())), shape=(count, self._num_columns)
        )
        f = (F @ np.where(free, 0.0, fixed)).reshape(-1, 3)
        radius = np.broadcast_to(self.problem.link_lengths, (*points.shape[:2], 4)).ravel()
        return Balls(F.tocsc()[:, free].tocsr(), f, (1 + LENGTH_TOLERANCE) * radius)


def _select_binding_rows(
    A: sparse.csr_matrix, low: Array, high: Array, lower: Array, upper: Array
) -> IntArray:
    """Return rows that bounds do not imply; switched-off big-M rows are redundant."""
    positive, negative = A.maximum(0), (-A).maximum(0)
    min_activity, max_activity = (
        positive @ lower - negative @ upper,
        positive @ upper - negative @ lower,
    )
    is_redundant = (min_activity >= low - _ROW_TOLERANCE) & (max_activity <= high + _ROW_TOLERANCE)
    return np.flatnonzero(~is_redundant)
