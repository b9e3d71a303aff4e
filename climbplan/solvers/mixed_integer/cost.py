"""Express the cost in the coordinates of nodes, with a proximal term that makes it definite.

The proximal term is 1/2 sum eps_i (w_i - center_i)^2. Its largest effect on a bound is subtracted
(`bounds`), so every w_i in which the cost is flat needs finite bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.row_stack import Coordinates
from climbplan.solvers.separable_cost import NotConvexCost, describe_nonconvexity, is_convex

_PROXIMAL = 1e-6  # of the cost's own curvature over the box, or of its linear part
_FLAT = 1e-11  # pivot of the Hessian below which a direction is flat, relative
_MARGIN = 1e-3  # relative, of the largest cost of a feasible point: tiny ranges amplify rounding


class Unbounded(UsageError):
    """Report that a direction without cost is unbounded, so that no lower bound can be proved."""


@dataclass(frozen=True)
class Cost:
    """The cost 1/2 w'Hw + g'w + constant, its proximal term, and L L' = H + diag(eps)."""

    H: Array  # (k, k)
    g: Array  # (k,)
    constant: float
    eps: Array  # (k,)
    center: Array  # (k,)
    L: Array  # (k, k)
    u: Array  # (k,) L u = g - eps center


def build_cost(instance: Instance, space: Coordinates, by_gradient: bool = False) -> Cost:
    """Build the cost over the independent variables w.

    Args:
        instance: Instance with a convex cost.
        space: The independent variables.
        by_gradient: Whether the linear cost sets the size of the proximal term where it outweighs
            the curvature. The term is larger then, so that bounds take more proximal steps, but
            the active-set method keeps its accuracy along flat directions.

    Raises:
        Unbounded: A direction without cost is not bounded.
        NotConvexCost: The cost has negative curvature.
    """
    n, k = instance.size, space.X.shape[1]
    P, q = instance.P, instance.q
    X, start = space.X[:n], space.start[:n]  # choices cost nothing
    H = X.T @ (P @ X)
    g = X.T @ (P @ start + q)
    low, high = space.lower[space.independent], space.upper[space.independent]
    half = 0.5 * (high - low)
    bounded = np.isfinite(half)
    eps = _size_proximal_term(H, g, half, by_gradient)
    center = np.zeros(k)
    center[bounded] = 0.5 * (low[bounded] + high[bounded])
    L = _factor(H + np.diag(eps), bounded)
    if L is None and not is_convex(P):
        raise NotConvexCost(describe_nonconvexity(instance.name))
    if L is None:
        raise Unbounded(
            f"{instance.name}: a direction without cost is not bounded, which branch-and-bound "
            "needs; give its variables bounds, or use method mccormick"
        )
    return Cost(
        H=H,
        g=g,
        constant=float(instance.constant + 0.5 * start @ P @ start + q @ start),
        eps=eps,
        center=center,
        L=L,
        u=solve_triangular(L, g - eps * center, lower=True) if k else np.zeros(0),
    )


def _size_proximal_term(H: Array, g: Array, half: Array, by_gradient: bool) -> Array:
    """Return eps (k,) of the proximal term, 0 where the half width `half` of a range is infinite.

    Its largest value eps half^2 / 2 is about the same for all variables.
    """
    bounded = np.isfinite(half)
    reach = np.where(bounded, np.maximum(half, 1e-9), 1.0)
    varied = bounded & (half > 0.0)  # the cost along fixed variables tells nothing of its size
    max_curvature = float(np.max(np.diag(H) * reach**2, initial=0.0, where=varied))
    linear_cost = float(np.sum(np.abs(g) * reach, where=varied))
    size = max(max_curvature, linear_cost) if by_gradient else max_curvature or linear_cost
    eta = _PROXIMAL * (size or 1.0)
    eps = np.where(bounded, eta / reach**2, 0.0)
    top = float(np.abs(np.diag(H)).max(initial=0.0))
    # Where bounds leave next to nothing the term need not grow beyond all others
    wide = float(np.median(reach[bounded])) if bounded.any() else 1.0
    eps = np.clip(eps, 1e-9 * top, max(top, eta / wide**2))
    eps = np.where(bounded, eps, 0.0)
    return np.asarray(np.minimum(eps, np.where(half > 0, np.inf, 1.0)))


def _factor(regular: Array, bounded: BoolArray) -> Array | None:
    """Return the Cholesky factor, or None where an unbounded direction is flat."""
    try:
        L: Array = np.linalg.cholesky(regular).astype(float)
    except np.linalg.LinAlgError:
        return None
    top = np.abs(np.diag(regular)).max(initial=0.0)
    flat = (np.diag(L) ** 2 < _FLAT * top) & ~bounded
    return None if flat.any() else L


def compute_max_cost(H: Array, g: Array, constant: float, lower: Array, upper: Array) -> float:
    """Return an upper bound on the cost over the box; an open box gives a huge finite number.

    Lower bounds beyond it prove that a node is empty, so it includes a margin for their rounding.
    """
    max_abs = np.maximum(np.abs(lower), np.abs(upper))
    if np.isfinite(max_abs).all():
        size = float(np.abs(g) @ max_abs + 0.5 * max_abs @ np.abs(H) @ max_abs)
        return constant + size + _MARGIN * max(1.0, abs(constant), size)
    return 1e15 * max(1.0, abs(constant), float(np.abs(g).max(initial=0.0)))
