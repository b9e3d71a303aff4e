"""Measure how far an infeasible instance is from feasible: local minimum of violations.

With every choice fixed, the smallest sum of violations is a convex problem (elastic programming)
that Clarabel solves. Choices are then selected again at its solution, as long as that helps. This
local search explains infeasibility; it proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance

_PASSES = 6
_SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


@dataclass(frozen=True)
class ElasticSolution:
    """A point and the violation of each constraint there, zero where it holds."""

    x: Array  # (n,)
    assignment: IntArray  # chosen alternative of each choice
    balls: tuple[Array, ...]  # (K,) for each ball block
    rows: Array  # (m,)
    choices: Array  # (C,)

    @property
    def total(self) -> float:
        """Sum of all violations."""
        return float(self.rows.sum() + self.choices.sum() + sum(float(b.sum()) for b in self.balls))


def minimise_violations(instance: Instance, start: Array) -> ElasticSolution | None:
    """Find a point with small violations, near the choices that suit `start` (n,).

    Bounds of the variables are kept.

    Returns:
        None if Clarabel finds no point at all.
    """
    best: ElasticSolution | None = None
    assignment = instance.assignment(start)
    for _ in range(_PASSES):
        x = _minimise_sum(instance, assignment)
        if x is None:
            break
        violations = _compute_violations(instance, x, assignment)
        if best is not None and violations.total >= best.total - 1e-7:
            break
        best = violations
        assignment = instance.assignment(x)
    return best


def _compute_violations(instance: Instance, x: Array, assignment: IntArray) -> ElasticSolution:
    """Compute the violations at a point."""
    row = instance.A @ x
    row_violation = np.maximum(instance.row_lower - row, row - instance.row_upper)
    chosen = zip(instance.choices, assignment, strict=True)
    return ElasticSolution(
        x=x,
        assignment=assignment,
        balls=tuple(np.maximum(b.excess(x), 0.0) for b in instance.balls),
        rows=np.maximum(row_violation, 0.0),
        choices=np.array([c.alternatives[k].violation(c.point(x)) for c, k in chosen]),
    )


def _minimise_sum(instance: Instance, assignment: IntArray) -> Array | None:
    """Minimise sum t such that balls, rows and chosen alternatives hold within t."""
    n = instance.size
    slack_count = sum(b.count for b in instance.balls) + instance.A.shape[0] + len(instance.choices)
    blocks: list[sparse.csr_matrix] = []
    values: list[Array] = []
    next_slack = 0

    def with_slack(rows: sparse.csr_matrix, slack: IntArray) -> sparse.csr_matrix:
        count = rows.shape[0]
        slack_columns = sparse.csr_matrix(
            (-np.ones(count), (np.arange(count), slack)), shape=(count, slack_count)
        )
        return sparse.hstack([rows, slack_columns]).tocsr()

    unit = sparse.identity(n + slack_count, format="csr")
    for sign, bound in ((1.0, instance.upper), (-1.0, -instance.lower)):
        is_finite = np.flatnonzero(np.isfinite(bound))
        blocks.append(sign * unit[is_finite])
        values.append(bound[is_finite])
    blocks.append(-unit[n:])
    values.append(np.zeros(slack_count))
    slack = next_slack + np.arange(instance.A.shape[0])
    next_slack += instance.A.shape[0]
    for sign, bound in ((1.0, instance.row_upper), (-1.0, -instance.row_lower)):
        is_finite = np.flatnonzero(np.isfinite(bound))
        blocks.append(with_slack(sign * instance.A[is_finite], slack[is_finite]))
        values.append(bound[is_finite])
    for choice, k in zip(instance.choices, assignment, strict=True):
        polytope = choice.alternatives[k]
        rows = sparse.csr_matrix(np.vstack([polytope.A, polytope.C, -polytope.C]))
        bound = np.concatenate([polytope.b, polytope.c, -polytope.c])
        slack_index = np.full(len(bound), next_slack)
        blocks.append(with_slack(sparse.csr_matrix(rows @ choice.E), slack_index))
        values.append(bound - rows @ choice.e)
        next_slack += 1
    cones = [clarabel.NonnegativeConeT(sum(len(v) for v in values))]
    for balls in instance.balls:
        d = balls.f.shape[1]
        no_slack = sparse.csr_matrix((d, slack_count))
        for k, radius in enumerate(balls.radius):
            radius_row = with_slack(sparse.csr_matrix((1, n)), np.array([next_slack]))
            vector_rows = sparse.hstack([-balls.F[k * d : (k + 1) * d], no_slack])
            blocks.append(sparse.vstack([radius_row, vector_rows]).tocsr())
            values.append(np.concatenate([[radius], balls.f[k]]))
            cones.append(clarabel.SecondOrderConeT(d + 1))
            next_slack += 1
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cost = np.concatenate([np.zeros(n), np.ones(slack_count)])
    # A small curvature makes the point unique where violations do not determine it.
    quadratic = sparse.diags(np.concatenate([np.full(n, 1e-6), np.zeros(slack_count)])).tocsc()
    solver = clarabel.DefaultSolver(
        quadratic, cost, sparse.vstack(blocks).tocsc(), np.concatenate(values), cones, settings
    )
    solution = solver.solve()
    return np.array(solution.x)[:n] if solution.status in _SOLVED else None
