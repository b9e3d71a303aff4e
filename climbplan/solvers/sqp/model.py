"""A program with fixed integers, reduced by its linear equations.

x = shift + basis y. Rows are linear in y, contain products of two factors that are affine in y, or
are balls. All are dense, since one step of SQP is a small dense quadratic program.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.solvers.sqp.elimination import eliminate_equations, multiply_sparse, propagate_fixed

_MAX_ENTRIES = 4_000_000  # largest number of entries of a dense matrix
_BOUNDED_PREFERENCE = 0.1  # weight of bounded variables as pivots, against 1 for free ones
_NOTHING = 1e-12


@dataclass(frozen=True)
class NonlinearRows:
    """Rows lower <= N y + base + Qn w(y) <= upper and balls, all nonlinear in y."""

    N: Array  # (m, r)
    base: Array  # (m,)
    Q: Array  # (m, K)
    first: Array  # (K, r) slopes of the first factor of each product
    second: Array  # (K, r)
    first_base: Array  # (K,)
    second_base: Array  # (K,)
    lower: Array  # (m,)
    upper: Array  # (m,)
    ball: Array  # (B, d, r) vectors of balls: slopes
    ball_base: Array  # (B, d)
    radius: Array  # (B,)

    @property
    def count(self) -> int:
        """Number of rows and balls m + B."""
        return len(self.lower) + len(self.radius)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of all values: those of rows, then (-inf, 0) for balls."""
        no_bound = np.full(len(self.radius), -np.inf)
        return (
            np.concatenate([self.lower, no_bound]),
            np.concatenate([self.upper, np.zeros(len(self.radius))]),
        )

    def scale(self, size: Array) -> NonlinearRows:
        """Divide rows by sizes (m + B,); balls, which are lengths already, stay the same."""
        divisor = size[: len(self.lower)]
        return replace(
            self,
            N=self.N / divisor[:, None],
            base=self.base / divisor,
            Q=self.Q / divisor[:, None],
            lower=self.lower / divisor,
            upper=self.upper / divisor,
        )

    def evaluate(self, y: Array) -> Array:
        """Return the values of all rows, then (|v|^2 - radius^2) / (2 radius) of the balls."""
        w = (self.first @ y + self.first_base) * (self.second @ y + self.second_base)
        rows = self.N @ y + self.base + self.Q @ w
        if not len(self.radius):
            return np.asarray(rows)
        v = self.ball @ y + self.ball_base
        return np.concatenate([rows, (np.sum(v * v, axis=1) / self.radius - self.radius) / 2])

    def compute_jacobian(self, y: Array) -> Array:
        """Return the Jacobian (m + B, r)."""
        a, b = self.first @ y + self.first_base, self.second @ y + self.second_base
        rows = self.N + multiply_sparse(self.Q, a[:, None] * self.second + b[:, None] * self.first)
        if not len(self.radius):
            return np.asarray(rows)
        v = (self.ball @ y + self.ball_base) / self.radius[:, None]
        return np.vstack([rows, np.einsum("bd,bdr->br", v, self.ball)])

    def compute_hessian(self, multipliers: Array) -> Array:
        """Return the Hessian (r, r) of the rows weighted by multipliers (m + B,)."""
        m = len(self.lower)
        weight = self.Q.T @ multipliers[:m]
        half = multiply_sparse((weight[:, None] * self.first).T.copy(), self.second)
        hessian = half + half.T
        if len(self.radius):
            scaled = (multipliers[m:] / self.radius)[:, None, None] * self.ball
            hessian = hessian + np.einsum("bdr,bds->rs", scaled, self.ball)
        return np.asarray(hessian)


@dataclass(frozen=True)
class ReducedModel:
    """Minimise 1/2 y'P y + q'y + constant subject to bounds, linear rows and nonlinear rows."""

    shift: Array  # (n,)
    basis: Array  # (n, r)
    independent: IntArray  # (r,) indices of y in x
    P: Array
    q: Array
    constant: float
    low: Array  # (r,)
    high: Array
    L: Array  # (l, r)
    lower: Array  # (l,)
    upper: Array
    nonlinear_rows: NonlinearRows
    is_nonlinear: BoolArray  # (r,) whether a variable occurs in a product or ball

    def recover_point(self, y: Array) -> Array:
        """Return x (n,)."""
        return self.shift + multiply_sparse(self.basis, y[:, None])[:, 0]

    def objective(self, y: Array) -> float:
        """Return the exact cost."""
        return float(0.5 * y @ (self.P @ y) + self.q @ y + self.constant)


@dataclass(frozen=True)
class SqpForm:
    """All rows of one instance, dense; built once for all its integers."""

    fixed_form: FixedIntegerForm
    A: Array
    Q: Array
    P: Array
    balls: tuple[tuple[Array, Array, Array], ...]  # F (K, d, n), f (K, d), radius (K,)

    @classmethod
    def build(cls, instance: Instance) -> SqpForm:
        """Build the dense form of an instance.

        Raises:
            UsageError: The instance is too large for dense matrices.
        """
        fixed_form = FixedIntegerForm.of(instance)
        n, (m, K) = instance.size, fixed_form.Q.shape
        if m * (n + K) > _MAX_ENTRIES:
            raise UsageError(f"{instance.name}: too large for the dense SQP: use ipopt")
        balls = tuple(
            (b.F.toarray().reshape(*b.f.shape, n), b.f, np.maximum(b.radius, 1e-9))
            for b in instance.balls
            if b.count
        )
        return cls(
            fixed_form, fixed_form.A.toarray(), fixed_form.Q.toarray(), instance.P.toarray(), balls
        )

    def fix_integers(self, values: Array, alternatives: IntArray) -> ReducedModel | None:
        """Return the model at the integers of values (n,); None if linear rows alone contradict."""
        form, source = self.fixed_form, self.fixed_form.source
        is_active = form.find_active(values, alternatives)
        rows = _BilinearRows(
            self.A[is_active],
            self.Q[is_active],
            source.products.first,
            source.products.second,
            form.lower[is_active],
            form.upper[is_active],
        )
        low, high = source.lower.copy(), source.upper.copy()
        integers = np.round(values[source.integer])
        low[source.integer] = np.maximum(low[source.integer], integers)
        high[source.integer] = np.minimum(high[source.integer], integers)
        if not propagate_fixed(*rows, low, high):
            return None
        return self._eliminate(rows, low, high)

    def _eliminate(self, rows: _BilinearRows, low: Array, high: Array) -> ReducedModel | None:
        """Eliminate fixed variables and linear equations; None if linear rows contradict."""
        source = self.fixed_form.source
        rows = _substitute_fixed(rows, low, high)
        nonlinear = (rows.Q != 0).any(axis=1)
        has_several = (np.abs(rows.A) > _NOTHING).sum(axis=1) > 1  # the others are bounds by now
        equal = (rows.lower == rows.upper) & ~nonlinear & has_several
        coordinates = _solve_equations(rows.A[equal], rows.lower[equal], low, high)
        if coordinates is None:
            return None
        linear = _build_linear_rows(
            rows.select(~equal & ~nonlinear & has_several), coordinates, low, high
        )
        if linear is None:
            return None
        basis, shift, chosen = coordinates.basis, coordinates.shift, coordinates.independent
        curves = self._build_nonlinear_rows(rows.select(nonlinear), basis, shift)
        nonlinear_weight = np.abs(curves.first).sum(axis=0) + np.abs(curves.second).sum(axis=0)
        nonlinear_weight = nonlinear_weight + np.abs(curves.ball).sum(axis=(0, 1))
        gradient = multiply_sparse(self.P, shift[:, None])[:, 0]
        return ReducedModel(
            shift=shift,
            basis=basis,
            independent=chosen,
            P=multiply_sparse(basis.T.copy(), multiply_sparse(self.P, basis)),
            q=multiply_sparse((gradient + source.q)[None, :], basis)[0],
            constant=float(0.5 * shift @ gradient + source.q @ shift + source.constant),
            low=low[chosen],
            high=high[chosen],
            L=linear[0],
            lower=linear[1],
            upper=linear[2],
            nonlinear_rows=curves,
            is_nonlinear=nonlinear_weight > 0,
        )

    def _build_nonlinear_rows(
        self, rows: _BilinearRows, basis: Array, shift: Array
    ) -> NonlinearRows:
        """Build rows with products and balls over y."""
        is_used = (rows.Q != 0).any(axis=0)
        i, j = rows.first[is_used], rows.second[is_used]
        slopes = [F @ basis for F, _, _ in self.balls]
        bases = [F @ shift + f for F, f, _ in self.balls]
        widest = max((f.shape[1] for f in bases), default=0)
        slopes = [np.pad(s, ((0, 0), (0, widest - s.shape[1]), (0, 0))) for s in slopes]
        bases = [np.pad(b, ((0, 0), (0, widest - b.shape[1]))) for b in bases]
        return NonlinearRows(
            N=multiply_sparse(rows.A, basis),
            base=multiply_sparse(rows.A, shift[:, None])[:, 0],
            Q=rows.Q[:, is_used],
            first=basis[i],
            second=basis[j],
            first_base=shift[i],
            second_base=shift[j],
            lower=rows.lower,
            upper=rows.upper,
            ball=np.concatenate([np.zeros((0, widest, basis.shape[1])), *slopes]),
            ball_base=np.concatenate([np.zeros((0, widest)), *bases]),
            radius=np.concatenate([np.zeros(0), *(r for _, _, r in self.balls)]),
        )


class _BilinearRows(NamedTuple):
    """Rows lower <= A x + Q w <= upper with products w = x[first] x[second]."""

    A: Array  # (m, n)
    Q: Array  # (m, K)
    first: IntArray  # (K,)
    second: IntArray  # (K,)
    lower: Array  # (m,)
    upper: Array  # (m,)

    def select(self, mask: BoolArray) -> _BilinearRows:
        """Return the rows of a mask (m,)."""
        return self._replace(
            A=self.A[mask], Q=self.Q[mask], lower=self.lower[mask], upper=self.upper[mask]
        )


class _NullspaceMap(NamedTuple):
    """Map x = shift + basis y that satisfies linear equations and fixed variables."""

    basis: Array  # (n, r)
    shift: Array  # (n,)
    independent: IntArray  # (r,) indices of y in x
    dependent: IntArray  # variables for which an equation was solved


def _substitute_fixed(rows: _BilinearRows, low: Array, high: Array) -> _BilinearRows:
    """Substitute fixed variables; products with one are linear in the other, or constant."""
    A, Q, first, second, lower, upper = rows
    fixed = low == high
    is_bilinear = ~fixed[first] & ~fixed[second]
    if not is_bilinear.all():
        k = np.flatnonzero(~is_bilinear)
        fixed_factor = np.where(fixed[first[k]], first[k], second[k])
        free_factor = np.where(fixed[first[k]], second[k], first[k])
        fold = np.zeros((len(k), len(low)))
        fold[np.arange(len(k)), free_factor] = low[fixed_factor]
        A = A + multiply_sparse(Q[:, k], fold)
        Q = Q[:, is_bilinear]
        first, second = first[is_bilinear], second[is_bilinear]
    offset = multiply_sparse(A, np.where(fixed, low, 0.0)[:, None])[:, 0]
    A = np.where(fixed, 0.0, A)
    return _BilinearRows(A, Q, first, second, lower - offset, upper - offset)


def _solve_equations(E: Array, e: Array, low: Array, high: Array) -> _NullspaceMap | None:
    """Solve E x = e, both overwritten, for dependent variables; None if equations contradict.

    Variables without bounds are preferred, since the bounds of others become rows.
    """
    fixed = low == high
    bounded = np.isfinite(low) | np.isfinite(high)
    preference = np.where(fixed, 0.0, np.where(bounded, _BOUNDED_PREFERENCE, 1.0))
    pivot = np.full(len(e), -1, np.int64)
    if not eliminate_equations(E, e, preference, pivot):
        return None
    rows = np.flatnonzero(pivot >= 0)
    dependent = pivot[rows]
    free = ~fixed
    free[dependent] = False
    independent = np.flatnonzero(free)
    basis = np.zeros((len(low), len(independent)))
    basis[independent, np.arange(len(independent))] = 1.0
    basis[dependent] = -E[np.ix_(rows, independent)]
    shift = np.where(fixed, low, 0.0)
    shift[dependent] = e[rows]
    return _NullspaceMap(basis, shift, independent, dependent)


def _build_linear_rows(
    rows: _BilinearRows, coordinates: _NullspaceMap, low: Array, high: Array
) -> tuple[Array, Array, Array] | None:
    """Return linear rows and bounds of dependent variables as lower <= L y <= upper.

    Returns:
        L, lower and upper; None if a row without variables is violated.
    """
    basis, shift, dependent = coordinates.basis, coordinates.shift, coordinates.dependent
    bounded = dependent[np.isfinite(low[dependent]) | np.isfinite(high[dependent])]
    L = np.vstack([multiply_sparse(rows.A, basis), basis[bounded]])
    row_shift = np.concatenate([multiply_sparse(rows.A, shift[:, None])[:, 0], shift[bounded]])
    lower = np.concatenate([rows.lower, low[bounded]]) - row_shift
    upper = np.concatenate([rows.upper, high[bounded]]) - row_shift
    empty = np.abs(L).max(axis=1, initial=0.0) <= _NOTHING
    slack = 1e-8 * (1.0 + np.abs(row_shift))
    if (empty & ((lower > slack) | (upper < -slack))).any():
        return None
    return L[~empty], lower[~empty], upper[~empty]
