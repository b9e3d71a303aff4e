"""The convex problem that is left when every choice is made, solved by Clarabel.

Mixed-integer solvers work to 1e-6 in each row. Their assignments are kept, and the continuous
variables are found again to full accuracy, so that plans verify whatever solver made them.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.result import Indices

_ACCURACY = 1e-10
_SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


def complete(instance: Instance, assignment: Indices) -> Array | None:
    """The best x (n,) with the given alternative of each choice, None if there is none.

    min 1/2 x'Px + q'x over rows and balls: Clarabel's form A x + s = b, s in zero cone, positive
    orthant, second-order cones.
    """
    unit = sparse.identity(instance.size, format="csr")
    fixed = np.isfinite(instance.lower) & (instance.lower == instance.upper)
    tight = np.isfinite(instance.row_lower) & (instance.row_lower == instance.row_upper)
    equal = [(unit[fixed], instance.lower[fixed]), (instance.A[tight], instance.row_lower[tight])]
    less = [
        _below(unit, instance.upper, ~fixed),
        _below(-unit, -instance.lower, ~fixed),
        _below(instance.A, instance.row_upper, ~tight),
        _below(-instance.A, -instance.row_lower, ~tight),
    ]
    for choice, k in zip(instance.choices, assignment, strict=True):
        polytope = choice.alternatives[k]
        C, A = sparse.csr_matrix(polytope.C), sparse.csr_matrix(polytope.A)
        equal.append((C @ choice.E, polytope.c - polytope.C @ choice.e))
        less.append((A @ choice.E, polytope.b - polytope.A @ choice.e))
    blocks, values = [], []
    for rows, bound in [*equal, *less]:
        blocks.append(sparse.csr_matrix(rows))
        values.append(np.asarray(bound))
    cones = [
        clarabel.ZeroConeT(sum(len(b) for _, b in equal)),
        clarabel.NonnegativeConeT(sum(len(b) for _, b in less)),
    ]
    for balls in instance.balls:
        d = balls.f.shape[1]
        for k, radius in enumerate(balls.radius):
            rows = balls.F[k * d : (k + 1) * d]
            blocks.append(sparse.vstack([sparse.csr_matrix((1, instance.size)), -rows]).tocsr())
            values.append(np.concatenate([[radius], balls.f[k]]))
            cones.append(clarabel.SecondOrderConeT(d + 1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = _ACCURACY
    solver = clarabel.DefaultSolver(
        sparse.triu(instance.P, format="csc"),
        instance.q,
        sparse.vstack(blocks).tocsc(),
        np.concatenate(values),
        cones,
        settings,
    )
    solution = solver.solve()
    return np.array(solution.x) if solution.status in _SOLVED else None


def _below(
    rows: sparse.csr_matrix, bound: Array, open_rows: Array
) -> tuple[sparse.csr_matrix, Array]:
    kept = np.flatnonzero(np.isfinite(bound) & open_rows)
    return rows[kept], bound[kept]
