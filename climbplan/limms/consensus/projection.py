"""The mixed-integer block with frozen integers: a projection, eq. (6.12a) as a conic program.

Its norm is that of the other block, so that the dual means the same in both, and a knot that
differs from all others pulls with its distance: in the L1 norm of the mixed-integer block a foot
that stands still is where most knots have it, however far the last one is. Lengths of links are
balls.
"""

from __future__ import annotations

import time

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.consensus.copies import Copy, Found, modes_of
from climbplan.limms.consensus.lengths import LONGER
from climbplan.limms.consensus.mixed_integer import MixedInteger
from climbplan.limms.consensus.nonlinear import BOX_WEIGHT, POINT_WEIGHT
from climbplan.program.instance import Balls, Implications, Instance, Products
from climbplan.solvers.convex.clarabel import ClarabelSession

_SAME = 1e-9  # a row that no point within the bounds breaks by more says nothing


class Projection:
    """The block with the integers of one answer; free blocks of links come with each target."""

    def __init__(self, block: MixedInteger, x: Array) -> None:
        """x: the answer, which stays as near to the goal as it is."""
        self.setting, self.columns, self.rows = block.setting, block.columns, block.rows
        rows, c = block.rows, block.columns
        self._x = x.copy()
        self._count = block.stated_columns
        stated = slice(0, block.stated_rows)
        self._matrix = rows.matrix()[stated, : self._count].tocsc()
        self._row_lower, self._row_upper = rows.row_lower[stated], rows.row_upper[stated]
        self._cost = np.array(rows.cost)[: self._count]
        self._lower, self._upper = (
            np.array(v, float)[: self._count] for v in (rows.lower, rows.upper)
        )
        whole = np.flatnonzero(np.array(rows.integer)[: self._count])
        self._lower[whole] = self._upper[whole] = np.round(x[whole])
        self._upper[c.missed] = x[c.missed] + 1e-6
        self._session = ClarabelSession()

    def solve(self, target: Copy, weight: float, region: IntArray) -> Found:
        """The nearest answer to a target, with links in free blocks (K + 1, L, 4) after the start.

        Where these leave no answer, blocks stay as they were.
        """
        began = time.perf_counter()
        kept = self._x
        x = self._project(target, weight, self._placed(region))
        if x is None:
            x = self._project(target, weight, kept[: self._count])
        spent = time.perf_counter() - began
        if x is None:
            return Found("infeasible", None, None, None, np.inf, spent, None)
        c = self.columns
        self._x = np.concatenate([x, kept[self._count :]])
        copy = Copy(x[c.position], x[c.points])
        return Found(
            "optimal",
            copy,
            modes_of(self.setting, c, self._x),
            x[c.velocity],
            float(np.linalg.norm(copy.box[-1] - self.setting.scene.goal)),
            spent,
            self._x,
            self.rows.worst(self._x),
        )

    def _placed(self, region: IntArray) -> Array:
        """The last answer with other free blocks."""
        x, columns = self._x[: self._count].copy(), self.columns.region
        if len(columns):
            chosen = np.moveaxis(region[1:], 0, -1).swapaxes(0, 1)  # (4, L, K)
            x[columns[..., 1:]] = np.arange(len(columns))[:, None, None, None] == chosen
        return x

    def _project(self, target: Copy, weight: float, x: Array) -> Array | None:
        """Its columns, free blocks those of x; None if there is no answer."""
        c = self.columns
        lower, upper = self._lower.copy(), self._upper.copy()
        region = c.region.ravel()
        lower[region] = upper[region] = np.round(x[region])
        free = lower < upper
        shift = self._matrix @ np.where(free, 0.0, lower)
        A = self._matrix[:, free].tocsr()
        keep = _binding(
            A, self._row_lower - shift, self._row_upper - shift, lower[free], upper[free]
        )
        pull = np.zeros(self._count)
        wanted = np.zeros(self._count)
        for columns, values, share in (
            (c.position, target.box, BOX_WEIGHT),
            (c.points, target.points, POINT_WEIGHT),
        ):
            pull[columns], wanted[columns] = 2 * weight * share, values
        size = int(free.sum())
        none, nothing = sparse.csr_matrix((0, size)), np.zeros(0)
        instance = Instance(
            name="projection",
            P=sparse.diags(pull[free]).tocsc(),
            q=(self._cost - pull * wanted)[free],
            constant=0.0,
            lower=lower[free],
            upper=upper[free],
            A=A[keep],
            row_lower=(self._row_lower - shift)[keep],
            row_upper=(self._row_upper - shift)[keep],
            balls=(self._links(free, lower),),
            choices=(),
            integer=np.zeros(size, bool),
            products=Products(np.zeros(0, int), np.zeros(0, int)),
            Q=sparse.csr_matrix((len(keep), 0)),
            implications=Implications(
                none,
                sparse.csr_matrix((0, 0)),
                nothing,
                nothing,
                np.zeros(0, int),
                np.zeros(0, bool),
            ),
        )
        answer = self._session.solve(instance)
        if answer.x is None:
            return None
        found = lower.copy()
        found[free] = answer.x
        return found

    def _links(self, free: BoolArray, fixed: Array) -> Balls:
        """Links after the start no longer than they are."""
        points = self.columns.points[1:]
        ends = points[..., 1:, :].reshape(-1, 3), points[..., :-1, :].reshape(-1, 3)
        count = 3 * len(ends[0])
        row = np.arange(count)
        F = sparse.csr_matrix(
            (np.ones(count), (row, ends[0].ravel())), shape=(count, self._count)
        ) - sparse.csr_matrix((np.ones(count), (row, ends[1].ravel())), shape=(count, self._count))
        f = (F @ np.where(free, 0.0, fixed)).reshape(-1, 3)
        radius = np.broadcast_to(self.setting.links, (*points.shape[:2], 4)).ravel()
        return Balls(F.tocsc()[:, free].tocsr(), f, (1 + LONGER) * radius)


def _binding(A: sparse.csr_matrix, low: Array, high: Array, lower: Array, upper: Array) -> IntArray:
    """Rows that bounds do not keep already: big-M rows that are switched off fall away."""
    up, down = A.maximum(0), (-A).maximum(0)
    least, most = up @ lower - down @ upper, up @ upper - down @ lower
    loose = (least >= low - _SAME) & (most <= high + _SAME)
    return np.flatnonzero(~loose)
