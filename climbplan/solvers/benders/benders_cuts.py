"""Generalised Benders cuts, stored as multipliers and evaluated at the parameters of any problem.

With integers fixed, the subproblem is a convex quadratic program over the rows of the indicator
form. Its multipliers y at integers d* bound the cost v(d) at all others (Geoffrion 1972). With the
Lagrangian at the current parameters,

    v(d) >= min_x L(x, y) - sum_e c_e |d_e - d*_e|,
    c_e = max over the box of sum_(i activated by e) y_i (C_i x - edge_i),

because rows that e no longer activates drop out, and together they are worth at most c_e. A
variable e that occurs in other rows is fixed to d*_e by an equation, whose multiplier is its slope.
Rays of an infeasible subproblem give the same without the cost: a value that must not be positive.

A stored cut consists of y, d* and the subproblem's solution only. It is therefore as valid at other
parameters as at its own (as in arXiv 2406.00780).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram
from climbplan.solvers.mixed_integer.row_keys import KeySpace

_PASSES = 3  # proximal iterations for the minimum of the Lagrangian
_ROUNDING = 1e-13  # relative rounding error of the sums in a cut
_FLAT = 1e-9  # relative slope of an unbounded direction that counts as zero


@dataclass(frozen=True)
class BendersCut:
    """Multipliers of one subproblem."""

    key: IntArray  # rows by `KeySpace`: bounds of variables, plain and indicator rows
    y: Array  # positive at upper bounds, negative at lower ones, for the stated rows
    star: Array  # (size,) the subproblem's solution, including its integers
    feasible: bool  # False for a ray of an infeasible subproblem

    def shift(self, space: KeySpace, shift: HorizonShift) -> BendersCut:
        """Return the cut for a shifted horizon."""
        key = space.remap(self.key, shift.variable, shift.row, shift.condition)
        star, remains = self.star.copy(), shift.variable >= 0
        star[shift.variable[remains]] = self.star[remains]
        return BendersCut(key[key >= 0], self.y[key >= 0], star, self.feasible)


@dataclass(frozen=True)
class CutPlanes:
    """K half-spaces: bound - sum_e slope_e |d_e - star_e| is at most v(d), for a ray at most 0."""

    bound: Array  # (K,)
    slope: Array  # (K, E) not negative
    star: BoolArray  # (K, E)
    feasible: BoolArray  # (K,) False for rays

    @classmethod
    def exclude(cls, integers: IntArray) -> CutPlanes:
        """Return the no-good cut that excludes one set of integers."""
        star = integers[None] > 0
        return cls(np.ones(1), np.ones(star.shape), star, np.zeros(1, bool))

    def tighten_slopes(self, cost_lower_bound: float) -> CutPlanes:
        """Reduce slopes to what is needed where no cost is below `least`."""
        height = np.where(self.feasible, self.bound - cost_lower_bound, self.bound)
        return CutPlanes(
            self.bound,
            np.minimum(self.slope, np.maximum(height, 0.0)[:, None]),
            self.star,
            self.feasible,
        )


class CutEvaluator:
    """Evaluates cuts at the parameters of one problem."""

    def __init__(self, form: IndicatorForm, program: MixedIntegerProgram) -> None:
        """Collect all rows of the indicator form over w."""
        self.program = program
        self._C = form.C
        rows = sparse.vstack([sparse.identity(form.size), form.A, form.C]).tocsr()
        self._rows = rows @ program.X  # (size + m + c, k)
        row_start = rows @ program.start
        self._lower = (
            np.concatenate([program.lower, form.row_lower, form.indicator_lower]) - row_start
        )
        self._upper = (
            np.concatenate([program.upper, form.row_upper, form.indicator_upper]) - row_start
        )
        self._row_start = row_start
        self.space = KeySpace(form.size, len(form.row_lower), len(form.indicator), form.size)
        entity_of = np.full(form.size, -1)
        entity_of[program.entities] = np.arange(len(program.entities))
        self._entity_of, self._indicator_entity = entity_of, entity_of[form.indicator]

    def evaluate(self, cuts: list[BendersCut]) -> CutPlanes:
        """Evaluate cuts as half-spaces over the integers."""
        E, K = len(self.program.entities), len(cuts)
        star = np.array([c.star[self.program.entities] > 0.5 for c in cuts], bool).reshape(K, E)
        feasible = np.array([c.feasible for c in cuts], bool)
        cut = np.repeat(np.arange(K), [len(c.key) for c in cuts])
        key = np.concatenate([np.zeros(0, np.int64), *(c.key for c in cuts)])
        y = np.concatenate([np.zeros(0), *(c.y for c in cuts)])
        edge = np.where(y > 0, self._upper[key], self._lower[key])
        # An integer with a column is fixed to its value
        entity = np.where(
            key < len(self._entity_of),
            self._entity_of[np.minimum(key, len(self._entity_of) - 1)],
            -1,
        )
        is_fixed = entity >= 0
        edge[is_fixed] = star[cut[is_fixed], entity[is_fixed]] - self._row_start[key[is_fixed]]
        is_finite = np.isfinite(edge)  # a bound that no longer exists contributes nothing
        cut, key, y, edge, entity, is_fixed = (
            array[is_finite] for array in (cut, key, y, edge, entity, is_fixed)
        )
        Y = sparse.csr_matrix((y, (cut, key)), (K, len(self._upper)))
        gradient = Y @ self._rows
        shift = np.asarray(-np.bincount(cut, y * edge, K), float)
        magnitude = np.bincount(cut, np.abs(y * edge), K)
        points = np.array([c.star for c in cuts]).reshape(K, len(self._entity_of))
        bound = self._minimise_lagrangian(gradient, shift, points, feasible)
        bound -= _ROUNDING * (magnitude + np.where(np.isfinite(bound), np.abs(bound), 0.0))
        slope = np.zeros((K, E))
        flip = np.where(star, -1.0, 1.0)
        np.add.at(
            slope,
            (cut[is_fixed], entity[is_fixed]),
            y[is_fixed] * flip[cut[is_fixed], entity[is_fixed]],
        )
        self._add_indicator_slopes(slope, cut, key, y, edge)
        # Where a flip can only raise the bound, the plane is written about the other value
        is_negative = slope < 0.0
        bound = bound - np.where(is_negative, slope, 0.0).sum(axis=1)
        return CutPlanes(bound, np.abs(slope), star ^ is_negative, feasible)

    def _add_indicator_slopes(
        self, slope: Array, cut: IntArray, key: IntArray, y: Array, edge: Array
    ) -> None:
        """Add to the slopes the largest value of the rows that an integer deactivates."""
        selected = np.flatnonzero(key >= self.space.first_conditional)
        if not len(selected):
            return
        row, E = key[selected] - self.space.first_conditional, slope.shape[1]
        pair, pair_of_row = np.unique(
            cut[selected] * E + self._indicator_entity[row], return_inverse=True
        )
        weights = sparse.csr_matrix(
            (y[selected], (pair_of_row, row)), (len(pair), self._C.shape[0])
        )
        sums = sparse.csr_matrix(weights @ self._C)
        sums.eliminate_zeros()
        p = self.program
        ends = np.where(sums.data > 0, p.upper[sums.indices], p.lower[sums.indices])
        pair_of_entry = np.repeat(np.arange(len(pair)), np.diff(sums.indptr))
        max_value = np.bincount(pair_of_entry, sums.data * ends, len(pair))
        stated = edge[selected] + self._row_start[key[selected]]
        max_value -= np.bincount(pair_of_row, y[selected] * stated, len(pair))
        slope[pair // E, pair % E] += max_value

    def _minimise_lagrangian(
        self, gradient: Array, shift: Array, points: Array, feasible: BoolArray
    ) -> Array:
        """Return (K,) lower bounds on the Lagrangians cost + pull w + shift over the box.

        A convex function is bounded from below by its tangent at any w, minimised over the box.
        """
        n, p = self.program.data, self.program
        low, high = n.box_lower, n.box_upper
        H, eps = n.H, n.eps
        w = np.clip(points[:, p.independent], low, high)
        lower_bound = np.full(len(gradient), -np.inf)
        for _ in range(_PASSES if feasible.any() else 1):
            center = np.clip(w, low, high)
            w = -cho_solve((n.L, True), (n.g + gradient - eps * center).T).T
            w = np.where(feasible[:, None], w, center)
            curved = np.where(feasible[:, None], w @ H, 0.0)
            cost = np.where(feasible, n.constant + w @ n.g, 0.0)
            value = cost + 0.5 * (curved * w).sum(axis=1) + (gradient * w).sum(axis=1) + shift
            slope = curved + np.where(feasible[:, None], n.g, 0.0) + gradient
            scale = np.abs(gradient).max(axis=1, initial=0.0, keepdims=True) + np.abs(n.g).max(
                initial=0.0
            )
            slope = np.where(
                (np.abs(slope) <= _FLAT * scale) & ~np.isfinite(high - low), 0.0, slope
            )
            with np.errstate(invalid="ignore"):
                descent = np.where(slope > 0, slope * (low - w), slope * (high - w))
            descent = np.where(slope == 0.0, 0.0, descent)
            lower_bound = np.maximum(lower_bound, value + descent.sum(axis=1))
        return lower_bound
