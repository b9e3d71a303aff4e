"""The coefficients of a program at one parameter value, which solvers read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.polytope import Polytope
from climbplan.program.smooth import Smooth


@dataclass(frozen=True)
class Balls:
    """K constraints || F_k x + f_k ||_2 <= radius_k + slope_k x, all of the same dimension d.

    With a slope they are general second-order cones.
    """

    F: sparse.csr_matrix  # (K d, n) rows of ball k are k d ... k d + d - 1
    f: Array  # (K, d)
    radius: Array  # (K,)
    slope: sparse.csr_matrix | None = None  # (K, n), None for radii that are constant

    @property
    def count(self) -> int:
        """Number of balls K."""
        return len(self.radius)

    def vectors(self, x: Array) -> Array:
        """Return F_k x + f_k, (K, d)."""
        return (self.F @ x).reshape(self.f.shape) + self.f

    def limits(self, x: Array) -> Array:
        """Return radius_k + slope_k x, (K,)."""
        return self.radius if self.slope is None else np.asarray(self.radius + self.slope @ x)

    def excess(self, x: Array) -> Array:
        """Return || F_k x + f_k || - radius_k - slope_k x, (K,), positive where violated."""
        return np.linalg.norm(self.vectors(x), axis=1) - self.limits(x)


@dataclass(frozen=True)
class Choice:
    """Disjunction: y = E x + e lies in at least one of the alternatives, with one binary each."""

    name: str
    E: sparse.csr_matrix  # (d, n)
    e: Array  # (d,)
    alternatives: tuple[Polytope, ...]

    def point(self, x: Array) -> Array:
        """Return y (d,)."""
        return np.asarray(self.E @ x + self.e)

    def violations(self, x: Array) -> Array:
        """Return the violation of each alternative at x, (R,)."""
        y = self.point(x)
        return np.array([p.violation(y) for p in self.alternatives])


@dataclass(frozen=True)
class Products:
    """K bilinear terms w_k = x[first_k] x[second_k], squares among them."""

    first: IntArray  # (K,) first <= second
    second: IntArray  # (K,)

    @property
    def count(self) -> int:
        """Number of products K."""
        return len(self.first)

    def values(self, x: Array) -> Array:
        """Return w (K,) at x."""
        return np.asarray(x[self.first] * x[self.second])


@dataclass(frozen=True)
class Implications:
    """Rows that hold only where a binary has a value.

    x[binary_i] = value_i implies lower_i <= A_i x + Q_i w <= upper_i.
    """

    A: sparse.csr_matrix  # (m, n)
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,)
    upper: Array  # (m,)
    binary: IntArray  # (m,) index of the binary in x
    value: BoolArray  # (m,)

    @property
    def count(self) -> int:
        """Number of rows m."""
        return len(self.lower)

    def active(self, x: Array) -> BoolArray:
        """Return the mask of rows that must hold at x, with binaries rounded."""
        return np.asarray((x[self.binary] > 0.5) == self.value)

    def violations(self, x: Array, w: Array) -> Array:
        """Return the violation of each row, (m,), zero where it need not hold."""
        row = self.A @ x + self.Q @ w
        outside = np.maximum(np.maximum(self.lower - row, row - self.upper), 0.0)
        return np.where(self.active(x), outside, 0.0)


@dataclass(frozen=True)
class Instance:
    """Minimise 1/2 x'Px + q'x + constant over bounds, rows, balls, choices and implications.

    Rows and implications may contain products w of two variables. `integer` variables are binaries
    where their bounds are 0 and 1, and implications hang on binaries alone.
    """

    name: str
    P: sparse.csc_matrix  # (n, n) symmetric positive semidefinite
    q: Array  # (n,)
    constant: float
    lower: Array  # (n,)
    upper: Array  # (n,)
    A: sparse.csr_matrix  # (m, n) row_lower <= A x + Q w <= row_upper
    row_lower: Array  # (m,)
    row_upper: Array  # (m,)
    balls: tuple[Balls, ...]
    choices: tuple[Choice, ...]
    integer: BoolArray  # (n,)
    products: Products
    Q: sparse.csr_matrix  # (m, K)
    implications: Implications
    smooth: Smooth | None = None

    @property
    def features(self) -> frozenset[str]:
        """Features that a solver must support beyond convex quadratic programs over rows."""
        present = {
            "balls": any(b.count for b in self.balls),
            "cones": any(b.count and b.slope is not None for b in self.balls),
            "integers beyond 0 and 1": bool(
                ((self.lower < 0.0) | (self.upper > 1.0))[self.integer].any()
            ),
            "choices": bool(self.choices),
            "integers": bool(self.integer.any()),
            "implications": bool(self.implications.count),
            "products": bool(self.products.count),
            "smooth": self.smooth is not None,
        }
        return frozenset(name for name, is_present in present.items() if is_present)

    @property
    def size(self) -> int:
        """Number of variables n."""
        return len(self.q)

    @property
    def binary_count(self) -> int:
        """Number of stated binaries and of alternatives of all choices."""
        return int(self.integer.sum()) + sum(len(c.alternatives) for c in self.choices)

    def objective(self, x: Array) -> float:
        """Return the exact cost at x."""
        return float(0.5 * x @ (self.P @ x) + self.q @ x + self.constant)

    def assignment(self, x: Array) -> IntArray:
        """Return the least violated alternative of each choice at x."""
        return np.array([int(np.argmin(c.violations(x))) for c in self.choices], np.int64)

    def violation(self, x: Array, assignment: IntArray | None = None) -> float:
        """Return the largest violation of any constraint at x (0 if feasible)."""
        chosen = self.assignment(x) if assignment is None else assignment
        worst = [0.0, float((self.lower - x).max()), float((x - self.upper).max())]
        w = self.products.values(x)
        if self.A.shape[0]:
            row = self.A @ x + self.Q @ w
            worst += [float((self.row_lower - row).max()), float((row - self.row_upper).max())]
        worst += [float(balls.excess(x).max()) for balls in self.balls if balls.count]
        worst.append(float(np.abs(x - np.round(x))[self.integer].max(initial=0.0)))
        worst.append(float(self.implications.violations(x, w).max(initial=0.0)))
        if self.smooth is not None:
            worst.append(float(self.smooth.outside(x).max()))
        worst += [
            c.alternatives[k].violation(c.point(x))
            for c, k in zip(self.choices, chosen, strict=True)
        ]
        return max(worst)
