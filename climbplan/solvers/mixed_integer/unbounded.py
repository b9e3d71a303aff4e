"""Show that a mixed-integer program with cones is unbounded below, or has no feasible point.

With a feasible point x and a direction d of integer entries at the integers, x + k d stays feasible
for every natural k if d satisfies the rows with sides 0, P d = 0, and lies in the cones without
their constants. The cost then falls without end where q'd < 0.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.progress import hide_searches
from climbplan.solvers.mixed_integer.conic_tree import ConicTree

_RADIUS = 100.0  # of the box of directions
_FALLING = 1e-6  # least fall of the cost along a direction
_NODES = (5, 20, 100, 500, 4000)  # of the trees, until a point or direction is found


@dataclass(frozen=True)
class UnboundedProof:
    """What is known of a program whose relaxation is unbounded."""

    point: Array | None  # (n,) feasible
    direction: Array | None  # (n,) in which the cost falls from any feasible point
    is_infeasible: bool  # whether no point is feasible

    @property
    def is_unbounded(self) -> bool:
        """Return whether the program is proved to be unbounded."""
        return self.point is not None and self.direction is not None


def examine_unbounded(instance: Instance, time_limit: float = np.inf) -> UnboundedProof:
    """Look for a feasible point and a direction in which the cost falls without end.

    Args:
        instance: Instance of rows, balls, cones and integers whose relaxation is unbounded.
        time_limit: Time limit [s].
    """
    deadline = time.perf_counter() + time_limit
    with hide_searches():
        return _find_point_and_direction(instance, deadline)


def _find_point_and_direction(instance: Instance, deadline: float) -> UnboundedProof:
    """Look for both until a deadline of `time.perf_counter` [s]."""
    n = instance.size
    free = replace(instance, P=sparse.csc_matrix((n, n)), q=np.zeros(n), constant=0.0)
    points = ConicTree(free)
    for max_nodes in _NODES:
        points.run(deadline, max_nodes)
        if points.incumbent is not None or points.is_finished:
            break
    is_infeasible = points.incumbent is None and points.is_finished
    if points.incumbent is None:
        return UnboundedProof(None, None, is_infeasible)
    directions, falls = ConicTree(_state_directions(instance)), False
    for max_nodes in _NODES:
        directions.run(deadline, max_nodes)
        falls = directions.cost < -_FALLING
        if falls or directions.is_finished:
            break
    return UnboundedProof(points.incumbent, directions.incumbent if falls else None, False)


def _state_directions(instance: Instance) -> Instance:
    """Return the program of directions in a box: minimise q'd."""
    n = instance.size
    curved = sparse.csr_matrix(instance.P)
    curved = curved[np.diff(curved.indptr) > 0]
    rows, ends = [sparse.csr_matrix(instance.A), curved], np.zeros(curved.shape[0])
    lower, upper = [_drop_side(instance.row_lower), ends], [_drop_side(instance.row_upper), ends]
    cones = []
    for balls in instance.balls:
        if balls.slope is None:  # |F d| <= 0
            rows.append(balls.F)
            lower.append(np.zeros(balls.F.shape[0]))
            upper.append(np.zeros(balls.F.shape[0]))
        else:
            cones.append(replace(balls, f=np.zeros_like(balls.f), radius=np.zeros(balls.count)))
    A = sparse.vstack(rows).tocsr()
    return replace(
        instance,
        P=sparse.csc_matrix((n, n)),
        constant=0.0,
        lower=np.maximum(_drop_side(instance.lower), -_RADIUS),
        upper=np.minimum(_drop_side(instance.upper), _RADIUS),
        A=A,
        row_lower=np.concatenate(lower),
        row_upper=np.concatenate(upper),
        Q=sparse.csr_matrix((A.shape[0], 0)),
        balls=tuple(cones),
    )


def _drop_side(side: Array) -> Array:
    """Return 0 for finite sides, infinite ones as they are."""
    return np.where(np.isfinite(side), 0.0, side)
