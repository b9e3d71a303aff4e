"""How far an infeasible instance is from feasible: least violations, found locally.

With every choice made, the smallest sum of violations is a convex problem (Clarabel). Choices are
then made anew at its solution, as long as that helps: a local search, used to explain, never to
prove.
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
class Violations:
    """A point and by how much each constraint fails there, zero where it holds."""

    x: Array  # (n,)
    assignment: IntArray  # chosen alternative of each choice
    balls: tuple[Array, ...]  # (K,) for each ball block
    rows: Array  # (m,)
    choices: Array  # (C,)

    @property
    def total(self) -> float:
        """Sum of all violations."""
        return float(self.rows.sum() + self.choices.sum() + sum(float(b.sum()) for b in self.balls))


def least_violations(instance: Instance, start: Array) -> Violations | None:
    """A point with small violations, near the choices that suit `start` (n,).

    Bounds of the variables are kept. None if Clarabel finds no point at all.
    """
    best: Violations | None = None
    assignment = instance.assignment(start)
    for _ in range(_PASSES):
        x = _least_sum(instance, assignment)
        if x is None:
            break
        found = _violations(instance, x, assignment)
        if best is not None and found.total >= best.total - 1e-7:
            break
        best = found
        assignment = instance.assignment(x)
    return best


def _violations(instance: Instance, x: Array, assignment: IntArray) -> Violations:
    row = instance.A @ x
    outside = np.maximum(instance.row_lower - row, row - instance.row_upper)
    chosen = zip(instance.choices, assignment, strict=True)
    return Violations(
        x=x,
        assignment=assignment,
        balls=tuple(np.maximum(b.excess(x), 0.0) for b in instance.balls),
        rows=np.maximum(outside, 0.0),
        choices=np.array([c.alternatives[k].violation(c.point(x)) for c, k in chosen]),
    )


def _least_sum(instance: Instance, assignment: IntArray) -> Array | None:
    """min sum t over || F x + f || <= r + t, rows and chosen alternatives within t of holding."""
    n = instance.size
    slack_count = sum(b.count for b in instance.balls) + instance.A.shape[0] + len(instance.choices)
    blocks: list[sparse.csr_matrix] = []
    values: list[Array] = []
    next_slack = 0

    def with_slack(rows: sparse.csr_matrix, slack: IntArray) -> sparse.csr_matrix:
        count = rows.shape[0]
        place = sparse.csr_matrix(
            (-np.ones(count), (np.arange(count), slack)), shape=(count, slack_count)
        )
        return sparse.hstack([rows, place]).tocsr()

    unit = sparse.identity(n + slack_count, format="csr")
    for sign, bound in ((1.0, instance.upper), (-1.0, -instance.lower)):
        held = np.flatnonzero(np.isfinite(bound))
        blocks.append(sign * unit[held])
        values.append(bound[held])
    blocks.append(-unit[n:])
    values.append(np.zeros(slack_count))
    slack = next_slack + np.arange(instance.A.shape[0])
    next_slack += instance.A.shape[0]
    for sign, bound in ((1.0, instance.row_upper), (-1.0, -instance.row_lower)):
        held = np.flatnonzero(np.isfinite(bound))
        blocks.append(with_slack(sign * instance.A[held], slack[held]))
        values.append(bound[held])
    for choice, k in zip(instance.choices, assignment, strict=True):
        polytope = choice.alternatives[k]
        rows = sparse.csr_matrix(np.vstack([polytope.A, polytope.C, -polytope.C]))
        bound = np.concatenate([polytope.b, polytope.c, -polytope.c])
        one = np.full(len(bound), next_slack)
        blocks.append(with_slack(sparse.csr_matrix(rows @ choice.E), one))
        values.append(bound - rows @ choice.e)
        next_slack += 1
    cones = [clarabel.NonnegativeConeT(sum(len(v) for v in values))]
    for balls in instance.balls:
        d = balls.f.shape[1]
        nothing = sparse.csr_matrix((d, slack_count))
        for k, radius in enumerate(balls.radius):
            edge = with_slack(sparse.csr_matrix((1, n)), np.array([next_slack]))
            inside = sparse.hstack([-balls.F[k * d : (k + 1) * d], nothing])
            blocks.append(sparse.vstack([edge, inside]).tocsr())
            values.append(np.concatenate([[radius], balls.f[k]]))
            cones.append(clarabel.SecondOrderConeT(d + 1))
            next_slack += 1
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cost = np.concatenate([np.zeros(n), np.ones(slack_count)])
    # A trace of curvature makes the point unique where violations leave it open.
    quadratic = sparse.diags(np.concatenate([np.full(n, 1e-6), np.zeros(slack_count)])).tocsc()
    solver = clarabel.DefaultSolver(
        quadratic, cost, sparse.vstack(blocks).tocsc(), np.concatenate(values), cones, settings
    )
    solution = solver.solve()
    return np.array(solution.x)[:n] if solution.status in _SOLVED else None
