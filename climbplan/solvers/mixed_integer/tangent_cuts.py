"""Outer approximation of norm constraints (balls and cones) by tangent half-spaces.

A tangent is valid for every point of the cone, so it is valid in the whole tree (Duran and
Grossmann 1986).
"""

from __future__ import annotations

import numpy as np

from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.nodes import SearchState
from climbplan.solvers.mixed_integer.problem_data import ALWAYS, ProblemData


@compiled
def _compute_limit(n: ProblemData, s: SearchState, b: int) -> float:
    """Return radius + slope w of a ball at s.w."""
    limit = n.radius[b]
    for j in range(len(s.u)):
        limit += n.slope[b, j] * s.w[j]
    return limit


@compiled
def _add_tangent_cuts(n: ProblemData, s: SearchState, tolerance: float) -> int:
    """Add the tangent at s.w of every violated ball; return their number, -1 if rows are exhausted.

    With a = (F w + f) / |F w + f|, every w' satisfies a'(F w' + f) <= |F w' + f| <= radius + g'w'.
    """
    k, added = len(s.u), 0
    for b in range(len(n.radius)):
        vector = s.vector
        length = 0.0
        for d in range(len(vector)):
            vector[d] = n.ball[b, d]
            line = n.ball_rows[b, d]
            for j in range(k):
                vector[d] += line[j] * s.w[j]
            length += vector[d] * vector[d]
        length = np.sqrt(length)
        if length - _compute_limit(n, s, b) <= tolerance:
            continue
        length = max(length, 1e-300)
        r = s.rows.num_used[0]
        if r >= len(n.activation):
            return -1
        row = s.rows.M[r]
        for j in range(k):
            row[j] = -n.slope[b, j]
        right_side = n.radius[b]
        for d in range(len(vector)):
            direction = vector[d] / length
            s.direction[r, d] = direction
            right_side -= direction * n.ball[b, d]
            line = n.ball_rows[b, d]
            for j in range(k):
                row[j] += direction * line[j]
        square = 0.0
        for j in range(k):
            total = row[j]
            for i in range(j):
                total -= n.L[j, i] * row[i]
            row[j] = total / n.L[j, j]
            square += row[j] * row[j]
        norm = max(np.sqrt(square), 1e-300)
        value_at_u = 0.0
        for j in range(k):
            row[j] /= norm
            s.rows.T[j, r] = row[j]
            value_at_u -= row[j] * s.u[j]
        n.norm[r], n.activation[r], n.entity[r] = norm, ALWAYS, -1
        s.tangent_to[r] = b
        s.offset[r] = value_at_u * norm
        s.rows.lower[r], s.rows.upper[r] = -np.inf, right_side / norm - value_at_u
        s.base_lower[r], s.base_upper[r] = s.rows.lower[r], s.rows.upper[r]
        s.rows.tolerance[r] = max(1e-9 / norm, 1e-13)
        s.rows.enabled[r] = 1
        s.rows.num_used[0] += 1
        added += 1
    return added


@compiled
def _max_ball_violation(n: ProblemData, s: SearchState) -> float:
    """Return the largest violation of the balls at s.w."""
    worst = 0.0
    for b in range(len(n.radius)):
        length = 0.0
        for d in range(n.ball.shape[1]):
            value = n.ball[b, d]
            line = n.ball_rows[b, d]
            for j in range(len(s.u)):
                value += line[j] * s.w[j]
            length += value * value
        worst = max(worst, np.sqrt(length) - _compute_limit(n, s, b))
    return worst
