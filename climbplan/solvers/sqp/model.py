"""A program with its integers given, in as few variables as its linear equalities leave.

x = shift + basis y. Rows are linear in y, or hold products of two factors that are affine in y,
or are balls; all dense, since one step of the method is a small dense quadratic program.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.sqp.elimination import eliminated, settled, thin_product

_DENSEST = 4_000_000  # numbers in a dense matrix: above, this method is the wrong one
_BOUNDED = 0.1  # preference for eliminating a variable that has bounds, to one that has none
_NOTHING = 1e-12


@dataclass(frozen=True)
class Curves:
    """Rows lower <= N y + base + Qn w(y) <= upper and balls, all not linear in y."""

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
        """m + B."""
        return len(self.lower) + len(self.radius)

    @property
    def ends(self) -> tuple[Array, Array]:
        """Bounds of all values: those of rows, then (-inf, 0) for balls."""
        none = np.full(len(self.radius), -np.inf)
        return (
            np.concatenate([self.lower, none]),
            np.concatenate([self.upper, np.zeros(len(self.radius))]),
        )

    def over(self, size: Array) -> Curves:
        """The same rows divided by sizes (m + B,); balls, which are lengths already, stay."""
        by = size[: len(self.lower)]
        return replace(
            self,
            N=self.N / by[:, None],
            base=self.base / by,
            Q=self.Q / by[:, None],
            lower=self.lower / by,
            upper=self.upper / by,
        )

    def values(self, y: Array) -> Array:
        """Of all rows, then (|v|^2 - radius^2) / (2 radius) of the balls."""
        w = (self.first @ y + self.first_base) * (self.second @ y + self.second_base)
        rows = self.N @ y + self.base + self.Q @ w
        if not len(self.radius):
            return np.asarray(rows)
        v = self.ball @ y + self.ball_base
        return np.concatenate([rows, (np.sum(v * v, axis=1) / self.radius - self.radius) / 2])

    def slopes(self, y: Array) -> Array:
        """(m + B, r)."""
        a, b = self.first @ y + self.first_base, self.second @ y + self.second_base
        rows = self.N + thin_product(self.Q, a[:, None] * self.second + b[:, None] * self.first)
        if not len(self.radius):
            return np.asarray(rows)
        v = (self.ball @ y + self.ball_base) / self.radius[:, None]
        return np.vstack([rows, np.einsum("bd,bdr->br", v, self.ball)])

    def curvature(self, multipliers: Array) -> Array:
        """Hessian (r, r) of multipliers' values, multipliers (m + B,)."""
        m = len(self.lower)
        weight = self.Q.T @ multipliers[:m]
        half = thin_product((weight[:, None] * self.first).T.copy(), self.second)
        hessian = half + half.T
        if len(self.radius):
            scaled = (multipliers[m:] / self.radius)[:, None, None] * self.ball
            hessian = hessian + np.einsum("bdr,bds->rs", scaled, self.ball)
        return np.asarray(hessian)


@dataclass(frozen=True)
class ReducedModel:
    """minimise 1/2 y'P y + q'y + constant over bounds, linear rows and curves."""

    shift: Array  # (n,)
    basis: Array  # (n, r)
    chosen: IntArray  # (r,) which variables are y
    P: Array
    q: Array
    constant: float
    low: Array  # (r,)
    high: Array
    L: Array  # (l, r)
    lower: Array  # (l,)
    upper: Array
    curves: Curves
    factor: BoolArray  # (r,) whether a variable enters a product or ball

    def point(self, y: Array) -> Array:
        """x (n,)."""
        return self.shift + thin_product(self.basis, y[:, None])[:, 0]

    def objective(self, y: Array) -> float:
        """Exact objective."""
        return float(0.5 * y @ (self.P @ y) + self.q @ y + self.constant)


@dataclass(frozen=True)
class SqpForm:
    """All rows of one instance, dense; built once for all its integers."""

    pinned: PinnedForm
    A: Array
    Q: Array
    P: Array
    balls: tuple[tuple[Array, Array, Array], ...]  # F (K, d, n), f (K, d), radius (K,)

    @classmethod
    def of(cls, instance: Instance) -> SqpForm:
        """Raises UsageError for instances too large for dense matrices."""
        pinned = PinnedForm.of(instance)
        n, (m, K) = instance.size, pinned.Q.shape
        if m * (n + K) > _DENSEST:
            raise UsageError(f"{instance.name}: too large for the dense SQP: use ipopt")
        balls = tuple(
            (b.F.toarray().reshape(*b.f.shape, n), b.f, np.maximum(b.radius, 1e-9))
            for b in instance.balls
            if b.count
        )
        return cls(pinned, pinned.A.toarray(), pinned.Q.toarray(), instance.P.toarray(), balls)

    def reduced(self, values: Array, alternatives: IntArray) -> ReducedModel | None:
        """What is left at the integers of values (n,); None if linear rows alone contradict."""
        form, source = self.pinned, self.pinned.source
        held = form.active(values, alternatives)
        A, Q = self.A[held], self.Q[held]
        lower, upper = form.lower[held], form.upper[held]
        first, second = source.products.first, source.products.second
        low, high = source.lower.copy(), source.upper.copy()
        given = np.round(values[source.integer])
        low[source.integer] = np.maximum(low[source.integer], given)
        high[source.integer] = np.minimum(high[source.integer], given)
        if not settled(A, Q, first, second, lower, upper, low, high):
            return None
        return self._reduced(A, Q, lower, upper, low, high)

    def _reduced(
        self, A: Array, Q: Array, lower: Array, upper: Array, low: Array, high: Array
    ) -> ReducedModel | None:
        source = self.pinned.source
        first, second = source.products.first, source.products.second
        fixed = low == high
        n = source.size
        # Products with a fixed factor are linear in the other one, or constant.
        curved = ~fixed[first] & ~fixed[second]
        if not curved.all():
            k = np.flatnonzero(~curved)
            known = np.where(fixed[first[k]], first[k], second[k])
            other = np.where(fixed[first[k]], second[k], first[k])
            fold = np.zeros((len(k), n))
            fold[np.arange(len(k)), other] = low[known]
            A = A + thin_product(Q[:, k], fold)
            Q = Q[:, curved]
            first, second = first[curved], second[curved]
        shift = np.where(fixed, low, 0.0)
        offset = thin_product(A, shift[:, None])[:, 0]
        A = np.where(fixed, 0.0, A)
        lower, upper = lower - offset, upper - offset
        nonlinear = (Q != 0).any(axis=1)
        several = (np.abs(A) > _NOTHING).sum(axis=1) > 1  # the others are bounds by now
        equal = (lower == upper) & ~nonlinear & several
        E, e = A[equal], lower[equal].copy()
        bounded = np.isfinite(low) | np.isfinite(high)
        preference = np.where(fixed, 0.0, np.where(bounded, _BOUNDED, 1.0))
        pivot = np.full(len(e), -1, np.int64)
        if not eliminated(E, e, preference, pivot):
            return None
        rows = np.flatnonzero(pivot >= 0)
        out = pivot[rows]
        free = ~fixed
        free[out] = False
        chosen = np.flatnonzero(free)
        basis = np.zeros((n, len(chosen)))
        basis[chosen, np.arange(len(chosen))] = 1.0
        basis[out] = -E[np.ix_(rows, chosen)]
        shift[out] = e[rows]

        kept = ~equal & ~nonlinear & several
        held = out[bounded[out]]  # bounds of variables that are now expressions
        L = np.vstack([thin_product(A[kept], basis), basis[held]])
        move = np.concatenate([thin_product(A[kept], shift[:, None])[:, 0], shift[held]])
        l_low = np.concatenate([lower[kept], low[held]]) - move
        l_high = np.concatenate([upper[kept], high[held]]) - move
        empty = np.abs(L).max(axis=1, initial=0.0) <= _NOTHING
        slack = 1e-8 * (1.0 + np.abs(move))
        if (empty & ((l_low > slack) | (l_high < -slack))).any():
            return None
        L, l_low, l_high = L[~empty], l_low[~empty], l_high[~empty]
        curves = self._curves(A, Q, lower, upper, first, second, basis, shift, nonlinear)
        used = np.abs(curves.first).sum(axis=0) + np.abs(curves.second).sum(axis=0)
        used = used + np.abs(curves.ball).sum(axis=(0, 1))
        half = thin_product(self.P, shift[:, None])[:, 0]
        return ReducedModel(
            shift=shift,
            basis=basis,
            chosen=chosen,
            P=thin_product(basis.T.copy(), thin_product(self.P, basis)),
            q=thin_product((half + source.q)[None, :], basis)[0],
            constant=float(0.5 * shift @ half + source.q @ shift + source.constant),
            low=low[chosen],
            high=high[chosen],
            L=L,
            lower=l_low,
            upper=l_high,
            curves=curves,
            factor=used > 0,
        )

    def _curves(
        self,
        A: Array,
        Q: Array,
        lower: Array,
        upper: Array,
        first: IntArray,
        second: IntArray,
        basis: Array,
        shift: Array,
        nonlinear: BoolArray,
    ) -> Curves:
        Qn = Q[nonlinear]
        used = (Qn != 0).any(axis=0)
        i, j = first[used], second[used]
        slopes = [F @ basis for F, _, _ in self.balls]
        bases = [F @ shift + f for F, f, _ in self.balls]
        widest = max((f.shape[1] for f in bases), default=0)
        slopes = [np.pad(s, ((0, 0), (0, widest - s.shape[1]), (0, 0))) for s in slopes]
        bases = [np.pad(b, ((0, 0), (0, widest - b.shape[1]))) for b in bases]
        return Curves(
            N=thin_product(A[nonlinear], basis),
            base=thin_product(A[nonlinear], shift[:, None])[:, 0],
            Q=Qn[:, used],
            first=basis[i],
            second=basis[j],
            first_base=shift[i],
            second_base=shift[j],
            lower=lower[nonlinear],
            upper=upper[nonlinear],
            ball=np.concatenate([np.zeros((0, widest, basis.shape[1])), *slopes]),
            ball_base=np.concatenate([np.zeros((0, widest)), *bases]),
            radius=np.concatenate([np.zeros(0), *(r for _, _, r in self.balls)]),
        )
