"""The point of problem P nearest to given factors: what makes solutions of alike terrains cluster.

Any point of a feasible set S_i may stand for it. Taking the one nearest to the centre of all makes
the data dense where the sets overlap, so that the box that meets every set (the theorem's first
condition) is small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.first_stage import FirstStage
from climbplan.program.instance import Instance
from climbplan.solvers.ipopt.instances import solve_ipopt

_TIME = 2.0  # [s]


def drawn_to(stage: FirstStage, centre: Array, weight: Array) -> Instance:
    """P with the cost sum of weight (factor - centre)^2; centre, weight: (N, 6)."""
    instance, at = stage.instance, stage.factors.ravel()
    w, c = weight.ravel(), centre.ravel()
    n = instance.size
    P = sparse.csc_matrix((2.0 * w, (at, at)), shape=(n, n))
    q = np.zeros(n)
    q[at] = -2.0 * w * c
    return replace(instance, P=P, q=q, constant=float(w @ c**2))


def nearest_point(stage: FirstStage, start: Array, centre: Array, weight: Array) -> Array | None:
    """A local optimum (N, 6) from the factors of a feasible point, None if IPOPT finds none."""
    x = np.zeros(stage.instance.size)
    x[stage.factors.ravel()] = start.ravel()
    found = solve_ipopt(drawn_to(stage, centre, weight), start=x, time_limit=_TIME).x
    return None if found is None else found[stage.factors]
