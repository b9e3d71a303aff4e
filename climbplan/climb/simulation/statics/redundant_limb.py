"""The toe of a limb of more than three joints, held at a place in the body frame.

Where the toe is does not say how the limb is bent: its joints are where their torques k play(theta
- command) - weight are those of one force at the toe, J^T f. Newton's method in angles and force
together: with H = k - f . d2p/dtheta2 a step is H d = J^T f - torque with J d + c f = place - p,
c being what the toe gives way. H bends down where a limb is pressed hard, which the toe's place
holds: with H + r J^T J for H, r large, the step is the same, and its pivots are positive where
joints stay.
"""

from __future__ import annotations

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.links import (
    CURVED,
    SQUASHED,
    STILL,
    TURNED,
    _arcs,
    _bent,
    _chain,
    _volume,
)
from climbplan.climb.simulation.statics.small_algebra import _dot, _inverse, _times
from climbplan.climb.simulation.statics.tuples import Pad, Springs

_TRIES = 25
_HOLDING = 10.0  # times the stiffness of joints that r counts


@compiled
def _held_by_more(
    zero: Array,
    limb: int,
    place: Array,
    springs: Springs,
    angles: Array,
    force: Array,
    slope: Array,
    pad: Pad,
) -> bool:
    """Force (3,) and slope (3, 3) of a toe held at a place (3,), body frame; angles are put right.

    zero: (2n + 1, 3) of the limb of that number. False if joints find no balance there, or none
    that they would stay in.
    """
    n, soft = len(angles), springs.soft[limb]
    columns, axes, toe, wanted = pad.columns, pad.axes, pad.v[0], pad.v[1]
    away, pushed = pad.v[2], pad.v[3]
    torque, firm, back, bent = pad.joints[0], pad.joints[1], pad.joints[2], pad.square
    turned, by_force, inner = pad.joints[3], pad.spread, pad.m[2]
    last = 1.0
    for _ in range(_TRIES):
        _chain(zero, angles, columns, axes, toe)
        springs.volume[limb] = _volume(columns)
        if not (soft > 0.0 or springs.volume[limb] > SQUASHED):
            return False
        _bent(limb, angles, springs, torque, firm)
        curved = last < CURVED
        if curved:
            _arcs(columns, axes, force, firm, bent)
        else:
            bent[:] = 0.0
            for j in range(n):
                bent[j, j] = firm[j]
        hold = _added(columns, firm, bent)
        for j in range(n):
            back[j] = torque[j]
            for a in range(3):
                by_force[j, a] = columns[j, a]
        if not _solved(bent, by_force, back):
            return False
        given = 1.0 - hold * soft
        for a in range(3):
            away[a] = place[a] - toe[a]
            wanted[a] = away[a] / given
            for b in range(3):
                inner[a, b] = soft / given if a == b else 0.0
            for j in range(n):
                wanted[a] += columns[j, a] * back[j]
                for b in range(3):
                    inner[a, b] += columns[j, a] * by_force[j, b]
        _inverse(inner, slope)
        _times(slope, wanted, pushed)
        longest = 0.0
        for j in range(n):
            turned[j] = _dot(by_force[j], pushed) - back[j]
            longest = max(longest, abs(turned[j]))
        for a in range(3):
            force[a] = (pushed[a] - hold * away[a]) / given
            for b in range(3):
                slope[a, b] = (slope[a, b] / given - (hold if a == b else 0.0)) / given
        part = 1.0 if longest <= TURNED else TURNED / longest
        for j in range(n):
            angles[j] += part * turned[j]
        last = longest
        if curved and last < STILL:
            return True
    return False


@compiled
def _added(columns: Array, firm: Array, matrix: Array) -> float:
    """Add r J^T J to a matrix (n, n), J (3, n) by its columns (n, 3), and say r [N/m]."""
    stiffest, longest = 0.0, 1e-12
    for j in range(len(firm)):
        stiffest = max(stiffest, firm[j])
        longest = max(longest, _dot(columns[j], columns[j]))
    hold = _HOLDING * stiffest / longest
    for i in range(len(firm)):
        for j in range(len(firm)):
            matrix[i, j] += hold * _dot(columns[i], columns[j])
    return float(hold)


@compiled
def _solved(matrix: Array, many: Array, vector: Array) -> bool:
    """Solve matrix (n, n) x = many (n, 3) and = vector (n,) in place, matrix destroyed.

    False unless all pivots are > 0: of joints that stay where they are, all are.
    """
    n = len(vector)
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 1e-9:
            return False
        for i in range(k + 1, n):
            factor = matrix[i, k] / pivot
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                vector[i] -= factor * vector[k]
                for a in range(3):
                    many[i, a] -= factor * many[k, a]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            vector[k] -= matrix[k, j] * vector[j]
            for a in range(3):
                many[k, a] -= matrix[k, j] * many[j, a]
        vector[k] /= matrix[k, k]
        for a in range(3):
            many[k, a] /= matrix[k, k]
    return True
