"""Benders cuts as multipliers, and what they say at the numbers of any problem of the statement.

With integers given, what is left is a convex quadratic program over the rows of the conditional
form. Its multipliers y at integers d* bound the cost v(d) at all others (Geoffrion 1972): with the
Lagrangian at the numbers of the problem at hand,

    v(d) >= min_x L(x, y) - sum_e c_e |d_e - d*_e|,
    c_e = max over the box of sum_(i decided by e) y_i (C_i x - edge_i),

as rows that e no longer decides are out of force, and no part of them is worth more than c_e. A
variable e that stands in other rows is held at d*_e by an equation, whose multiplier is its slope.
Rays of an infeasible program give the same without the cost: what must not be positive.

Nothing of a cut but y, d* and where the program's solution lay is kept, so that it is as valid at
other parameters as at its own (arXiv 2406.00780 keeps them in the same way).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.keys import KeySpace
from climbplan.solvers.mixed_integer.memory import Move
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram

_PASSES = 3  # of the Lagrangian's minimum, each nearer to where that is flat
_ROUNDING = 1e-13  # of the sums that a cut is, relative
_FLAT = 1e-9  # slope of a direction without bounds that counts as none, relative


@dataclass(frozen=True)
class Cut:
    """Multipliers of one program with its integers given."""

    key: IntArray  # rows by `KeySpace`: bounds of variables, plain and conditional rows
    y: Array  # positive at upper bounds, negative at lower ones, in the row's own unit
    star: Array  # (size,) the program's solution, with its integers
    feasible: bool  # False: a ray

    def moved(self, space: KeySpace, move: Move) -> Cut:
        """The same for a problem in which everything has moved."""
        key = space.moved(self.key, move.variable, move.row, move.condition)
        star, there = self.star.copy(), move.variable >= 0
        star[move.variable[there]] = self.star[there]
        return Cut(key[key >= 0], self.y[key >= 0], star, self.feasible)


@dataclass(frozen=True)
class Planes:
    """K half-spaces: bound - sum_e slope_e |d_e - star_e| is at most v(d), of a ray at most 0."""

    bound: Array  # (K,)
    slope: Array  # (K, E) not negative
    star: BoolArray  # (K, E)
    feasible: BoolArray  # (K,) False for rays

    @classmethod
    def without(cls, integers: IntArray) -> Planes:
        """All but one set of integers."""
        star = integers[None] > 0
        return cls(np.ones(1), np.ones(star.shape), star, np.zeros(1, bool))

    def above(self, least: float) -> Planes:
        """Slopes no larger than they need be where no cost is less than `least`."""
        room = np.where(self.feasible, self.bound - least, self.bound)
        return Planes(
            self.bound,
            np.minimum(self.slope, np.maximum(room, 0.0)[:, None]),
            self.star,
            self.feasible,
        )


class CutForm:
    """One problem's numbers, at which cuts are read."""

    def __init__(self, form: Conditional, program: MixedIntegerProgram) -> None:
        self.program = program
        self._C = form.C
        rows = sparse.vstack([sparse.identity(form.size), form.A, form.C]).tocsr()
        self._rows = rows @ program.X  # (size + m + c, k)
        at = rows @ program.start
        self._lower = np.concatenate([program.lower, form.row_lower, form.when_lower]) - at
        self._upper = np.concatenate([program.upper, form.row_upper, form.when_upper]) - at
        self._at = at
        self.space = KeySpace(form.size, len(form.row_lower), len(form.when), form.size)
        number = np.full(form.size, -1)
        number[program.entities] = np.arange(len(program.entities))
        self._number, self._decides = number, number[form.when]

    def planes(self, cuts: list[Cut]) -> Planes:
        """What cuts say here."""
        E, K = len(self.program.entities), len(cuts)
        star = np.array([c.star[self.program.entities] > 0.5 for c in cuts], bool).reshape(K, E)
        feasible = np.array([c.feasible for c in cuts], bool)
        cut = np.repeat(np.arange(K), [len(c.key) for c in cuts])
        key = np.concatenate([np.zeros(0, np.int64), *(c.key for c in cuts)])
        y = np.concatenate([np.zeros(0), *(c.y for c in cuts)])
        edge = np.where(y > 0, self._upper[key], self._lower[key])
        # An integer with a column is held at its value
        entity = np.where(
            key < len(self._number), self._number[np.minimum(key, len(self._number) - 1)], -1
        )
        held = entity >= 0
        edge[held] = star[cut[held], entity[held]] - self._at[key[held]]
        there = np.isfinite(edge)  # a bound that is gone says nothing
        cut, key, y, edge, entity, held = (
            part[there] for part in (cut, key, y, edge, entity, held)
        )
        Y = sparse.csr_matrix((y, (cut, key)), (K, len(self._upper)))
        pull = Y @ self._rows
        shift = np.asarray(-np.bincount(cut, y * edge, K), float)
        size = np.bincount(cut, np.abs(y * edge), K)
        points = np.array([c.star for c in cuts]).reshape(K, len(self._number))
        bound = self._least(pull, shift, points, feasible)
        bound -= _ROUNDING * (size + np.where(np.isfinite(bound), np.abs(bound), 0.0))
        slope = np.zeros((K, E))
        flip = np.where(star, -1.0, 1.0)
        np.add.at(slope, (cut[held], entity[held]), y[held] * flip[cut[held], entity[held]])
        self._conditional(slope, cut, key, y, edge)
        # Where a flip can only raise the bound, the plane is told from the other value
        down = slope < 0.0
        bound = bound - np.where(down, slope, 0.0).sum(axis=1)
        return Planes(bound, np.abs(slope), star ^ down, feasible)

    def _conditional(
        self, slope: Array, cut: IntArray, key: IntArray, y: Array, edge: Array
    ) -> None:
        """Add the most that rows are worth which an integer no longer decides."""
        here = np.flatnonzero(key >= self.space.conditional)
        if not len(here):
            return
        row, E = key[here] - self.space.conditional, slope.shape[1]
        pair, at = np.unique(cut[here] * E + self._decides[row], return_inverse=True)
        weights = sparse.csr_matrix((y[here], (at, row)), (len(pair), self._C.shape[0]))
        sums = sparse.csr_matrix(weights @ self._C)
        sums.eliminate_zeros()
        p = self.program
        ends = np.where(sums.data > 0, p.upper[sums.indices], p.lower[sums.indices])
        of = np.repeat(np.arange(len(pair)), np.diff(sums.indptr))
        most = np.bincount(of, sums.data * ends, len(pair))
        stated = edge[here] + self._at[key[here]]
        most -= np.bincount(at, y[here] * stated, len(pair))
        slope[pair // E, pair % E] += most

    def _least(self, pull: Array, shift: Array, points: Array, feasible: BoolArray) -> Array:
        """(K,) least value of the Lagrangians cost + pull w + shift over the box.

        Of a convex function at any w: its value there, and its slope to the ends of the box.
        """
        n, p = self.program.numbers, self.program
        low, high = n.box_lower, n.box_upper
        H, eps = n.H, n.eps
        w = np.clip(points[:, p.independent], low, high)
        best = np.full(len(pull), -np.inf)
        for _ in range(_PASSES if feasible.any() else 1):
            center = np.clip(w, low, high)
            w = -cho_solve((n.L, True), (n.g + pull - eps * center).T).T
            w = np.where(feasible[:, None], w, center)
            curved = np.where(feasible[:, None], w @ H, 0.0)
            cost = np.where(feasible, n.constant + w @ n.g, 0.0)
            value = cost + 0.5 * (curved * w).sum(axis=1) + (pull * w).sum(axis=1) + shift
            slope = curved + np.where(feasible[:, None], n.g, 0.0) + pull
            scale = np.abs(pull).max(axis=1, initial=0.0, keepdims=True) + np.abs(n.g).max(
                initial=0.0
            )
            slope = np.where(
                (np.abs(slope) <= _FLAT * scale) & ~np.isfinite(high - low), 0.0, slope
            )
            with np.errstate(invalid="ignore"):
                way = np.where(slope > 0, slope * (low - w), slope * (high - w))
            way = np.where(slope == 0.0, 0.0, way)
            best = np.maximum(best, value + way.sum(axis=1))
        return best
