"""Node relaxations: a QP over rows, with balls as tangent half-spaces, re-solved by DAQP.

Minimise 1/2 |z|^2 over the rows of the pool, with the node's own bounds of choice rows. Only rows
near the last solution are passed to DAQP, and violated rows are added until none is left. In
coordinates without curvature proximal steps are made until they have no effect. Every bound is a
value of the dual function, computed here from the multipliers, so it does not depend on the
accuracy of DAQP.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import daqp
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.certificate import compute_farkas_bound
from climbplan.solvers.tree.choice_table import UNBOUNDED
from climbplan.solvers.tree.components import SAME
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.row_pool import AlternativeRows, RowPool

_TOLERANCES = (1e-9, 1e-8, 1e-7)  # of rows in their own unit; the next where DAQP cycles
_ITERATIONS = 2000  # limit of DAQP, reached only when it cycles
_SPARE = 40  # rows near the last solution that are passed in addition to the active ones
_OPTIMAL = (1, 2, 4)  # DAQP's flags for a solution
_INFEASIBLE = -1  # DAQP's flag for infeasible
_AT_UPPER, _AT_LOWER = 1, 3  # DAQP's senses of active rows
_PROXIMAL_TOLERANCE, _MAX_PROXIMAL_STEPS = (
    1e-9,
    20,
)  # tolerance and largest number of proximal steps


@dataclass(frozen=True)
class RelaxationPoint:
    """A relaxation's solution, from which the next one starts."""

    z: Array  # (k,)
    bound: float  # value of the dual function, a lower bound in any case
    active: IntArray  # (a,) rows with a multiplier
    multiplier: Array  # (a,) positive at the upper bound
    solved: bool = True  # False if DAQP failed: some rows may be violated


@dataclass(frozen=True)
class ClosedRelaxation:
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
    """Bounds of the choice rows at a node, cached for its next cut round."""

    masks: Masks | None
    lower: Array
    upper: Array
    alternatives: list[AlternativeRows]


class RelaxationSolver:
    """Solves the relaxations of one search."""

    def __init__(self, form: NormalForm, late: Callable[[], bool] = lambda: False) -> None:
        """Begin with an empty cache.

        `late` is called between QPs; once it is true, the best point so far is returned.
        """
        self.form = form
        self.late = late
        self.pool = RowPool(form)
        self.solves = 0
        self._last = _NodeBounds(None, np.zeros(0), np.zeros(0), [])
        self._identity = np.eye(form.size)
        self._model = daqp.Model()
        self._model.settings = {"eq_reduction": -1, "iter_limit": _ITERATIONS}

    def start(self) -> RelaxationPoint:
        """Return the minimum without any row."""
        no_rows = np.zeros(0, np.int64)
        return RelaxationPoint(
            np.zeros(self.form.size), self.form.cost.constant, no_rows, np.zeros(0)
        )

    def compute_bounds(self, masks: Masks) -> tuple[Array, Array]:
        """Return bounds of all rows of the pool at a node, including single alternatives."""
        form, pool = self.form, self.pool
        if masks is not self._last.masks:
            alternatives = [
                pool.ensure_alternative(c, mask.bit_length() - 1)
                for c, (table, mask) in enumerate(zip(form.tables, masks, strict=True))
                if not table.is_complete and mask & (mask - 1) == 0
            ]
            self._last = _NodeBounds(masks, *form.compute_choice_bounds(masks), alternatives)
        low, high = pool.lower.copy(), pool.upper.copy()
        low[form.choice_rows], high[form.choice_rows] = self._last.lower, self._last.upper
        for alternative in self._last.alternatives:
            low[alternative.span], high[alternative.span] = alternative.lower, alternative.upper
        return low, high

    def solve(
        self,
        lower: Array,
        upper: Array,
        start: RelaxationPoint,
        cutoff: float = np.inf,
        prove: bool = True,
    ) -> RelaxationPoint | ClosedRelaxation:
        """Solve the relaxation under bounds of all rows, from a nearby solution.

        Args:
            lower: (m,) lower bounds.
            upper: (m,) upper bounds.
            start: Nearby solution.
            cutoff: Bound at which no further search is needed.
            prove: Whether to prove infeasibility that DAQP reports.
        """
        if (lower > upper + SAME).any():
            return ClosedRelaxation(np.inf, True)
        bound = self.compute_dual_value(start.active, start.multiplier, lower, upper)
        point = replace(start, bound=bound, solved=False)
        sense = self._mark_active(start)
        right_side = np.where(start.multiplier > 0, upper[start.active], lower[start.active])
        sense[start.active[np.abs(right_side) >= UNBOUNDED]] = 0
        rows = self._select_near_rows(lower, upper, start)
        flat, num_proximal_steps = self.form.cost.flat, 0
        linear = self.form.cost.slope.copy()
        linear[flat] -= start.z[flat]
        is_cold, tolerance_level = False, 0
        while True:
            minimum, flag = self._solve_qp(rows, lower, upper, sense, linear, tolerance_level)
            if flag == _INFEASIBLE:
                closed = ClosedRelaxation(point.bound, certified=False)
                if prove and not self.late():
                    closed = self._prove_infeasible(rows, lower, upper, cutoff)
                if closed.certified or is_cold:
                    return closed
                is_cold, sense = True, np.zeros_like(sense)
                continue
            if minimum is None:
                tolerance_level += 1
                if tolerance_level == len(_TOLERANCES) or self.late():
                    return point
                continue
            point = minimum
            if point.bound >= cutoff:  # of some rows only, so it holds for all
                return ClosedRelaxation(point.bound, True)
            violation = self._measure_violation(point.z, lower, upper)
            violation[rows] = 0.0
            violated = np.flatnonzero(violation > _TOLERANCES[tolerance_level])
            proximal_step = point.z[flat] + linear[flat] - self.form.cost.slope[flat]
            is_short = np.abs(proximal_step).max(initial=0.0) <= _PROXIMAL_TOLERANCE
            if not len(violated) and (is_short or num_proximal_steps == _MAX_PROXIMAL_STEPS):
                return replace(point, solved=True)
            if self.late():
                return point
            linear[flat] -= proximal_step
            num_proximal_steps += not len(violated)
            sense = self._mark_active(point)
            rows = np.union1d(rows, violated)

    def _mark_active(self, point: RelaxationPoint) -> NDArray[np.int32]:
        """Return DAQP's senses (m,) of all rows, with those active at a point marked."""
        sense = np.zeros(self.pool.count, np.int32)
        sense[point.active] = np.where(point.multiplier > 0, _AT_UPPER, _AT_LOWER)
        return sense

    def _measure_violation(self, z: Array, lower: Array, upper: Array) -> Array:
        """Return the violation (m,) of all rows at z, negative where they hold."""
        value = self.pool.M @ z
        return np.maximum(value - upper, lower - value)

    def _select_near_rows(self, lower: Array, upper: Array, start: RelaxationPoint) -> IntArray:
        """Select the active rows of a point, those it violates, and some that are close."""
        pool = self.pool
        value = pool.M @ start.z
        slack = np.minimum(upper - value, value - lower) * pool.scale
        slack[start.active] = -np.inf
        slack[pool.scale == 0] = np.inf
        num_rows = max(len(start.active) + _SPARE, int((slack < 0).sum()) + _SPARE // 2)
        if num_rows >= len(slack):
            return np.arange(len(slack))
        return np.sort(np.argpartition(slack, num_rows)[:num_rows])

    def compute_dual_value(
        self, active: IntArray, multiplier: Array, lower: Array, upper: Array
    ) -> float:
        """Return -1/2 |M'l|^2 - l'b + constant, a lower bound for multipliers of the right sign.

        In flat coordinates the Lagrangian is linear and takes its minimum at their extent.
        """
        cost = self.form.cost
        right_side = np.where(multiplier > 0, upper[active], lower[active])
        gradient = multiplier @ self.pool.M[active] + cost.slope
        drop = 0.0
        if len(cost.flat):
            tilt = np.abs(gradient[cost.flat])
            drop = float(cost.extent[cost.flat][tilt > 0] @ tilt[tilt > 0])
            gradient[cost.flat] = 0.0
        return float(-0.5 * gradient @ gradient - multiplier @ right_side) + cost.constant - drop

    def cut_balls(self, z: Array, tolerance: float) -> CutRound:
        """Add the tangent half-space at z of every ball violated by more than the tolerance."""
        balls = self.form.balls
        vector = balls.vectors(z)
        length = np.sqrt(np.einsum("kd,kd->k", vector, vector))
        excess = length - balls.radii(z)
        violated = np.flatnonzero(excess > tolerance)
        if len(violated):
            # With u = v / |v|: u'(F z + f) <= |F z + f| <= radius + relief z everywhere.
            unit = vector[violated] / np.maximum(length[violated], 1e-300)[:, None]
            rows = np.einsum("kd,kdn->kn", unit, balls.F.reshape(*balls.f.shape, -1)[violated])
            if balls.relief is not None:
                rows = rows - balls.relief[violated]
            upper = balls.radius[violated] - np.einsum("kd,kd->k", unit, balls.f[violated])
            self.pool.append(
                rows, np.full(len(violated), -UNBOUNDED), upper, balls.component[violated]
            )
        return CutRound(len(violated), float(excess.max(initial=0.0)))

    def _solve_qp(
        self,
        rows: IntArray,
        lower: Array,
        upper: Array,
        sense: NDArray[np.int32],
        linear: Array,
        level: int,
    ) -> tuple[RelaxationPoint | None, int]:
        """Solve min 1/2 |z|^2 + linear z over some rows with DAQP; return minimum and flag.

        There is no minimum where DAQP fails. Other rows may be violated.
        """
        self._model.settings = {"primal_tol": _TOLERANCES[level]}
        M, low, high, sense = self.pool.M[rows], lower[rows], upper[rows], sense[rows]
        flag, _ = self._model.setup(self._identity, linear, M, high, low, sense)
        if flag < 0:  # dependent rows among those marked active
            sense = sense & ~_AT_LOWER
            flag, _ = self._model.setup(self._identity, linear, M, high, low, sense)
        if flag < 0:
            return None, int(flag)
        z, _, flag, info = self._model.solve()
        self.solves += 1
        if flag not in _OPTIMAL:
            return None, int(flag)
        is_active = np.flatnonzero(info["lam"])
        active, multiplier = rows[is_active], info["lam"][is_active]
        bound = self.compute_dual_value(active, multiplier, lower, upper)
        return RelaxationPoint(z, bound, active, multiplier, solved=False), int(flag)

    def _prove_infeasible(
        self, rows: IntArray, lower: Array, upper: Array, cutoff: float
    ) -> ClosedRelaxation:
        """Return what can be proved of rows that DAQP reports as infeasible."""
        cost = self.form.cost
        required_bound = min(cutoff, self.form.max_cost)
        bound = cost.constant + compute_farkas_bound(
            cost.slope,
            self.pool.M[rows],
            lower[rows],
            upper[rows],
            cost.extent,
            required_bound - cost.constant,
        )
        return ClosedRelaxation(
            np.inf if bound >= self.form.max_cost else bound, bound >= required_bound
        )
