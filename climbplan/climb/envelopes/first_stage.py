"""P1 and P2 of one posture: envelopes in place of products, then products put right.

P1 replaces the bilinear rows by McCormick envelopes on one box of (p, f), eq. (8.26), and keeps p
and f in it. `tightened`: the box is cut with the bounds that the terrain itself sets on each toe.
`propagated`: and with those that all rows of P imply within the box, products included. Neither
takes a feasible point away, but both make the envelopes tighter.
P2 keeps p of P1 and solves for f (convex), or starts the nonlinear program from P1 (NLP).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.climb.envelopes.search import TOLERANCE, minimise_product_error
from climbplan.climb.envelopes.statement import PostureStatement
from climbplan.climb.envelopes.terrains import LimbPatches
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.highs.linear import LinearProgram, solve_linear
from climbplan.solvers.ipopt.instances import solve_ipopt

Manner = Literal["propagated", "tightened", "published"]
_NLP_TIME = 2.0  # [s]
_CROSSED = 1e-9  # by which bounds may cross through rounding


@dataclass(frozen=True)
class FirstStage:
    """P1 on one terrain, prepared for any box."""

    instance: Instance
    form: LocalForm
    factors: IntArray  # (N, 6) columns of toe and force
    bounds: ElementwiseRange  # of all variables
    propagate: bool = False  # whether rows cut the box

    @classmethod
    def of(
        cls,
        statement: PostureStatement,
        patches: LimbPatches,
        manner: Manner = "propagated",
        load: Array | None = None,
    ) -> FirstStage:
        """Prepare a terrain."""
        instance = statement.program.instantiate(statement.theta(patches, load))
        toe, force = statement.program.variables["toe"], statement.program.variables["force"]
        shape = (statement.legs.count, 3)
        columns = np.concatenate(
            [
                np.arange(toe.start, toe.stop).reshape(shape),
                np.arange(force.start, force.stop).reshape(shape),
            ],
            axis=1,
        )
        lower, upper = instance.lower.copy(), instance.upper.copy()
        if manner != "published":
            corners = patches.vertices / statement.legs.length
            toe_columns = columns[:, :3].ravel()
            lower[toe_columns] = np.maximum(lower[toe_columns], corners.min(axis=1).ravel())
            upper[toe_columns] = np.minimum(upper[toe_columns], corners.max(axis=1).ravel())
        return cls(
            instance,
            LocalForm.of(instance),
            columns,
            ElementwiseRange(lower, upper),
            manner == "propagated",
        )

    def box(self, low: Array, high: Array) -> ElementwiseRange | None:
        """Return bounds of all variables within an envelope (N, 6) each, None if they cross."""
        lower, upper = self.bounds.lower.copy(), self.bounds.upper.copy()
        factor_columns = self.factors.ravel()
        lower[factor_columns] = np.maximum(lower[factor_columns], low.ravel())
        upper[factor_columns] = np.minimum(upper[factor_columns], high.ravel())
        if (lower > upper).any():
            return None
        return ElementwiseRange(lower, upper)

    def relax(self, low: Array, high: Array) -> Instance | None:
        """Return P1 on a box as a linear instance, None if the box misses the terrain."""
        box = self.box(low, high)
        if box is not None and self.propagate:
            box = self._propagate(box)
        return None if box is None else self.form.at(box)

    def _propagate(self, box: ElementwiseRange) -> ElementwiseRange | None:
        """Return what interval propagation leaves of a box, None if nothing."""
        propagated_box = propagate_box(replace(self.instance, lower=box.lower, upper=box.upper))
        if (propagated_box.lower > propagated_box.upper + _CROSSED).any():
            return None
        return ElementwiseRange(
            propagated_box.lower, np.maximum(propagated_box.lower, propagated_box.upper)
        )

    def solve(self, low: Array, high: Array, centre: Array | None = None) -> Array | None:
        """Return a point of P1 (n,), None if it has none.

        centre: (N, 6); the point has the least 1-norm distance of its factors from there.
        """
        local = self.relax(low, high)
        if local is None:
            return None
        solution = solve_linear(_build_nearest_program(local, self.factors.ravel(), centre))
        return None if solution.x is None else solution.x[: self.instance.size]

    def convex(self, x: Array) -> Array | None:
        """Return P2 with toes kept: a point of P, None if no forces balance there."""
        toe_columns = self.factors[:, :3].ravel()
        point_and_error = minimise_product_error(self.instance, x, toe_columns)
        if point_and_error is None or self.instance.violation(point_and_error[0]) > TOLERANCE:
            return None
        return point_and_error[0]

    def nlp(self, x: Array) -> Array | None:
        """Return P2 by IPOPT from the point of P1."""
        return solve_ipopt(self.instance, start=x, time_limit=_NLP_TIME).x


def _build_nearest_program(
    local: Instance, factor_columns: IntArray, centre: Array | None
) -> LinearProgram:
    n = local.size
    if centre is None:
        return LinearProgram(
            np.zeros(n), local.lower, local.upper, local.A, local.row_lower, local.row_upper
        )
    k = len(factor_columns)
    pick = sparse.csr_matrix((np.ones(k), (np.arange(k), factor_columns)), shape=(k, n))
    eye = sparse.identity(k)
    A = sparse.bmat([[local.A, None], [pick, -eye], [pick, eye]]).tocsr()
    c = centre.ravel()
    none, far = np.full(k, -np.inf), np.full(k, np.inf)
    return LinearProgram(
        np.concatenate([np.zeros(n), np.ones(k)]),
        np.concatenate([local.lower, np.zeros(k)]),
        np.concatenate([local.upper, np.full(k, np.inf)]),
        A,
        np.concatenate([local.row_lower, none, c]),
        np.concatenate([local.row_upper, c, far]),
    )
