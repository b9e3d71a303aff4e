"""Node relaxations: a QP over rows, with balls as tangent half-spaces, re-solved by DAQP.

min 1/2 |z|^2 over the rows of the pool, the choice rows with the node's own bounds. Only rows near
the last solution are passed; what they leave violated is added until nothing is. In coordinates
without curvature a proximal term is moved along until it has no effect. Every bound is a value of
the dual function, computed here from the multipliers, so it holds however well DAQP did.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import daqp
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.certificate import proved_bound
from climbplan.solvers.tree.choice_table import UNBOUNDED
from climbplan.solvers.tree.components import SAME
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.row_pool import OwnRange, RowPool

_TOLERANCES = (1e-9, 1e-8, 1e-7)  # of rows in their own unit; the next where DAQP cycles
_ITERATIONS = 2000  # of DAQP; more only happen when it cycles
_SPARE = 40  # rows near the last solution that are passed beside the active ones
_OPTIMAL = (1, 2, 4)  # DAQP's flags for a solution
_NONE = -1  # DAQP's flag for infeasible
_AT_UPPER, _AT_LOWER = 1, 3  # DAQP's senses of active rows
_SETTLED, _MOVES = 1e-9, 20  # of the proximal term


@dataclass(frozen=True)
class Point:
    """A relaxation's solution, and where the next one starts."""

    z: Array  # (k,)
    bound: float  # value of the dual function, a lower bound in any case
    active: IntArray  # (a,) rows with a multiplier
    multiplier: Array  # (a,) positive at the upper bound
    solved: bool = True  # False if DAQP failed: some rows may be violated


@dataclass(frozen=True)
class Closed:
    """A relaxation that needs no further search: infeasible, or its bound reaches the cutoff."""

    bound: float  # infinite if infeasible
    certified: bool  # whether the multipliers prove it


@dataclass(frozen=True)
class CutRound:
    """Tangents added at a point."""

    count: int
    excess: float  # largest violation of a ball [m]


@dataclass(frozen=True)
class _NodeBounds:
    """Bounds of the choice rows at a node, kept for its next cut round."""

    masks: Masks | None
    lower: Array
    upper: Array
    single: list[OwnRange]


class Relaxation:
    """Solves the relaxations of one search."""

    def __init__(self, form: NormalForm, late: Callable[[], bool] = lambda: False) -> None:
        """late: asked between QPs; once it says so, the best point so far is returned."""
        self.form = form
        self.late = late
        self.pool = RowPool(form)
        self.solves = 0
        self._last = _NodeBounds(None, np.zeros(0), np.zeros(0), [])
        self._identity = np.eye(form.size)
        self._no_point = np.zeros(form.size)
        self._model = daqp.Model()
        self._model.settings = {"eq_reduction": -1, "iter_limit": _ITERATIONS}

    def start(self) -> Point:
        """The minimum without any row."""
        none = np.zeros(0, np.int64)
        return Point(np.zeros(self.form.size), self.form.cost.constant, none, np.zeros(0))

    def bounds(self, masks: Masks) -> tuple[Array, Array]:
        """Bounds of all rows of the pool at a node: its choice rows, and what single ones state."""
        form, pool = self.form, self.pool
        if masks is not self._last.masks:
            single = [
                pool.own(c, mask.bit_length() - 1)
                for c, (table, mask) in enumerate(zip(form.tables, masks, strict=True))
                if not table.complete and mask & (mask - 1) == 0
            ]
            self._last = _NodeBounds(masks, *form.choice_bounds(masks), single)
        low, high = pool.lower.copy(), pool.upper.copy()
        low[form.choice_rows], high[form.choice_rows] = self._last.lower, self._last.upper
        for own in self._last.single:
            low[own.here], high[own.here] = own.lower, own.upper
        return low, high

    def solve(
        self,
        lower: Array,
        upper: Array,
        start: Point,
        cutoff: float = np.inf,
        prove: bool = True,
    ) -> Point | Closed:
        """The optimum under bounds of all rows, from a nearby solution.

        cutoff: a bound that needs no further search. prove: whether what DAQP calls infeasible is
        to be proved.
        """
        pool, M = self.pool, self.pool.M
        if (lower > upper + SAME).any():
            return Closed(np.inf, True)
        point = replace(
            start,
            bound=self.dual_value(start.active, start.multiplier, lower, upper),
            solved=False,
        )
        sense = np.zeros(pool.count, np.int32)
        at = np.where(start.multiplier > 0, upper[start.active], lower[start.active])
        sense[start.active] = np.where(start.multiplier > 0, _AT_UPPER, _AT_LOWER)
        sense[start.active[np.abs(at) >= UNBOUNDED]] = 0
        rows = self._near(lower, upper, start)
        flat, moves = self.form.cost.flat, 0
        linear = self.form.cost.slope.copy()
        linear[flat] -= start.z[flat]
        cold, level = False, 0
        while True:
            low, high = lower[rows], upper[rows]
            z, flag, multiplier = self._optimum(M[rows], low, high, sense[rows], linear, level)
            if flag == _NONE:
                closed = Closed(point.bound, certified=False)
                if prove and not self.late():
                    closed = self._infeasible(rows, lower, upper, cutoff)
                if closed.certified or cold:
                    return closed
                cold, sense = True, np.zeros_like(sense)
                continue
            if flag not in _OPTIMAL:
                level += 1
                if level == len(_TOLERANCES) or self.late():
                    return point
                continue
            held = np.flatnonzero(multiplier)
            active = rows[held]
            bound = self.dual_value(active, multiplier[held], lower, upper)
            point = Point(z, bound, active, multiplier[held], solved=False)
            if bound >= cutoff:  # of some rows only, so it holds for all
                return Closed(bound, True)
            value = M @ z
            violation = np.maximum(value - upper, lower - value)
            violation[rows] = 0.0
            new = np.flatnonzero(violation > _TOLERANCES[level])
            moved = z[flat] + linear[flat] - self.form.cost.slope[flat]
            settled = np.abs(moved).max(initial=0.0) <= _SETTLED or moves == _MOVES
            if not len(new) and settled:
                return replace(point, solved=True)
            if self.late():
                return point
            linear[flat] -= moved
            moves += not len(new)
            sense[:] = 0
            sense[active] = np.where(point.multiplier > 0, _AT_UPPER, _AT_LOWER)
            rows = np.union1d(rows, new)

    def _near(self, lower: Array, upper: Array, start: Point) -> IntArray:
        """The active rows of a point, those it violates, and some it nearly does."""
        pool = self.pool
        value = pool.M @ start.z
        slack = np.minimum(upper - value, value - lower) * pool.scale
        slack[start.active] = -np.inf
        slack[pool.scale == 0] = np.inf
        wanted = max(len(start.active) + _SPARE, int((slack < 0).sum()) + _SPARE // 2)
        if wanted >= len(slack):
            return np.arange(len(slack))
        return np.sort(np.argpartition(slack, wanted)[:wanted])

    def dual_value(self, active: IntArray, multiplier: Array, lower: Array, upper: Array) -> float:
        """-1/2 |M'l|^2 - l'b + constant: a lower bound for any multipliers of the right sign.

        In flat coordinates the Lagrangian is linear and takes its least value at their extent.
        """
        cost = self.form.cost
        at = np.where(multiplier > 0, upper[active], lower[active])
        pull = multiplier @ self.pool.M[active] + cost.slope
        drop = 0.0
        if len(cost.flat):
            tilt = np.abs(pull[cost.flat])
            drop = float(cost.extent[cost.flat][tilt > 0] @ tilt[tilt > 0])
            pull[cost.flat] = 0.0
        return float(-0.5 * pull @ pull - multiplier @ at) + cost.constant - drop

    def cut_balls(self, z: Array, tolerance: float) -> CutRound:
        """Add the tangent half-space at z of every ball violated by more than the tolerance."""
        balls = self.form.balls
        vector = balls.vectors(z)
        length = np.sqrt(np.einsum("kd,kd->k", vector, vector))
        excess = length - balls.radii(z)
        here = np.flatnonzero(excess > tolerance)
        if len(here):
            # With u = v / |v|: u'(F z + f) <= |F z + f| <= radius + relief z everywhere.
            unit = vector[here] / np.maximum(length[here], 1e-300)[:, None]
            rows = np.einsum("kd,kdn->kn", unit, balls.F.reshape(*balls.f.shape, -1)[here])
            if balls.relief is not None:
                rows = rows - balls.relief[here]
            upper = balls.radius[here] - np.einsum("kd,kd->k", unit, balls.f[here])
            self.pool.append(rows, np.full(len(here), -UNBOUNDED), upper, balls.part[here])
        return CutRound(len(here), float(excess.max(initial=0.0)))

    def _optimum(
        self,
        M: Array,
        lower: Array,
        upper: Array,
        sense: NDArray[np.int32],
        linear: Array,
        level: int,
    ) -> tuple[Array, int, Array]:
        """DAQP's solution of min 1/2 |z|^2 + linear z, flag and multipliers."""
        self._model.settings = {"primal_tol": _TOLERANCES[level]}
        flag, _ = self._model.setup(self._identity, linear, M, upper, lower, sense)
        if flag < 0:  # dependent rows among those marked active
            sense = sense & ~_AT_LOWER
            flag, _ = self._model.setup(self._identity, linear, M, upper, lower, sense)
        if flag < 0:
            return self._no_point, int(flag), np.zeros(len(M))
        z, _, flag, info = self._model.solve()
        self.solves += 1
        return z, int(flag), info["lam"]

    def _infeasible(self, rows: IntArray, lower: Array, upper: Array, cutoff: float) -> Closed:
        """What can be proved of rows that DAQP calls infeasible."""
        cost = self.form.cost
        enough = min(cutoff, self.form.ceiling)
        bound = cost.constant + proved_bound(
            cost.slope,
            self.pool.M[rows],
            lower[rows],
            upper[rows],
            cost.extent,
            enough - cost.constant,
        )
        return Closed(np.inf if bound >= self.form.ceiling else bound, bound >= enough)
