"""Balls as tangent half-spaces, which hold in the whole tree."""

from __future__ import annotations

import numpy as np

from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.nodes import Search
from climbplan.solvers.mixed_integer.numbers import ALWAYS, Numbers


@compiled
def _cut_balls(n: Numbers, s: Search, tolerated: float) -> int:
    """Add the tangent at s.w of every ball that is violated there; -1 without room for them.

    With a = (F w + f) / |F w + f|: a'(F w' + f) <= |F w' + f| <= radius for every w'.
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
        if length - n.radius[b] <= tolerated:
            continue
        r = s.rows.used[0]
        if r >= len(n.when):
            return -1
        row = s.rows.M[r]
        row[:] = 0.0
        edge = n.radius[b]
        for d in range(len(vector)):
            share = vector[d] / length
            s.direction[r, d] = share
            edge -= share * n.ball[b, d]
            line = n.ball_rows[b, d]
            for j in range(k):
                row[j] += share * line[j]
        square = 0.0
        for j in range(k):
            total = row[j]
            for i in range(j):
                total -= n.L[j, i] * row[i]
            row[j] = total / n.L[j, j]
            square += row[j] * row[j]
        norm = max(np.sqrt(square), 1e-300)
        at = 0.0
        for j in range(k):
            row[j] /= norm
            s.rows.T[j, r] = row[j]
            at -= row[j] * s.u[j]
        n.norm[r], n.when[r], n.entity[r] = norm, ALWAYS, -1
        s.tangent_to[r] = b
        s.offset[r] = at * norm
        s.rows.lower[r], s.rows.upper[r] = -np.inf, edge / norm - at
        s.base_lower[r], s.base_upper[r] = s.rows.lower[r], s.rows.upper[r]
        s.rows.tolerance[r] = max(1e-9 / norm, 1e-13)
        s.rows.on[r] = 1
        s.rows.used[0] += 1
        added += 1
    return added


@compiled
def _outside(n: Numbers, s: Search) -> float:
    """By how much s.w violates the balls."""
    worst = 0.0
    for b in range(len(n.radius)):
        length = 0.0
        for d in range(n.ball.shape[1]):
            value = n.ball[b, d]
            line = n.ball_rows[b, d]
            for j in range(len(s.u)):
                value += line[j] * s.w[j]
            length += value * value
        worst = max(worst, np.sqrt(length) - n.radius[b])
    return worst
