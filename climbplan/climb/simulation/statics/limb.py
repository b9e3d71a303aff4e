"""The toe of one limb, held at a place in the body frame: its force, and how the force changes.

Of a toe held at place p the contact force of a limb of three joints is f = J^-T (k play(theta -
command) - weight), by p it changes by J^-T (k - f . d2p/dtheta2) J^-1. Limbs of more joints are in
`redundant_limb.py`.
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
from climbplan.climb.simulation.statics.redundant_limb import _held_by_more
from climbplan.climb.simulation.statics.small_algebra import (
    _both_sides,
    _dot,
    _inverse,
    _times,
    _transposed_times,
)
from climbplan.climb.simulation.statics.tuples import Pad, Springs

_REACHED = 3e-5  # [m] after which one more step, which squares it, is the last
_TRIES = 12
_SPRUNG = 25  # tries with a toe that gives way


@compiled
def _held(
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

    zero: (2n + 1, 3) of the limb of that number. False if the place is not reached.
    """
    if len(angles) > 3:
        return _held_by_more(zero, limb, place, springs, angles, force, slope, pad)
    if springs.soft[limb] > 0.0:
        return _sprung_toe(zero, limb, place, springs, angles, force, slope, pad)
    columns, axes, inverse, middle = pad.columns, pad.axes, pad.m[2], pad.m[3]
    half_way = pad.m[4]
    toe, missing, turned, torque, firm = pad.v[0], pad.v[1], pad.v[2], pad.v[3], pad.v[4]
    done = False
    for _ in range(_TRIES):
        _chain(zero, angles, columns, axes, toe)
        volume = _inverse(columns, inverse)
        springs.volume[limb] = volume
        if not abs(volume) > SQUASHED:
            return False
        for i in range(3):
            missing[i] = place[i] - toe[i]
        _transposed_times(inverse, missing, turned)
        longest = max(abs(turned[0]), abs(turned[1]), abs(turned[2]))
        part = 1.0 if longest <= TURNED else TURNED / longest
        for j in range(3):
            angles[j] += part * turned[j]
        if abs(missing[0]) + abs(missing[1]) + abs(missing[2]) < _REACHED:
            done = True
            break
    if not done:
        return False
    _bent(limb, angles, springs, torque, firm)
    _times(inverse, torque, force)
    _arcs(columns, axes, force, firm, middle)
    _both_sides(inverse, middle, half_way, slope)
    return True


@compiled
def _sprung_toe(
    zero: Array,
    limb: int,
    place: Array,
    springs: Springs,
    angles: Array,
    force: Array,
    slope: Array,
    pad: Pad,
) -> bool:
    """As `_held`, of a toe that gives way: the joints' torques balance (place - p) / c.

    J^T (place - p) / c = k play(theta - command) - weight, by Newton's method in the angles; with
    H = k - f . d2p, df/dplace = (I - J (J^T J + c H)^-1 J^T) / c. False if they find no balance.
    """
    soft = springs.soft[limb]
    columns, axes, inverse, middle = pad.columns, pad.axes, pad.m[2], pad.m[3]
    toe, torque, firm, off, turned = pad.v[0], pad.v[3], pad.v[4], pad.v[1], pad.v[2]
    last = 1.0
    for _ in range(_SPRUNG):
        _chain(zero, angles, columns, axes, toe)
        for i in range(3):
            force[i] = (place[i] - toe[i]) / soft
        _bent(limb, angles, springs, torque, firm)
        curved = last < CURVED
        if curved:
            _arcs(columns, axes, force, firm, middle)
        else:
            middle[:] = 0.0
            for j in range(3):
                middle[j, j] = firm[j]
        for i in range(3):
            off[i] = _dot(columns[i], force) - torque[i]
            for j in range(3):
                middle[i, j] = soft * middle[i, j] + _dot(columns[i], columns[j])
        _inverse(middle, inverse)
        _times(inverse, off, turned)
        last = 0.0
        for j in range(3):
            turned[j] *= soft
            last = max(last, abs(turned[j]))
        part = 1.0 if last <= TURNED else TURNED / last
        for j in range(3):
            angles[j] += part * turned[j]
        if curved and last < STILL:
            springs.volume[limb] = _volume(columns)
            _transposed_times(columns, turned, off)
            for i in range(3):
                force[i] -= off[i] / soft
                for j in range(3):
                    torque[j] = columns[0, j] * inverse[0, i]
                    torque[j] += columns[1, j] * inverse[1, i] + columns[2, j] * inverse[2, i]
                for j in range(3):
                    pad.m[4][i, j] = torque[j]  # row i of (J^T J + c H)^-1 J^T
            for i in range(3):
                for j in range(3):
                    held = 0.0
                    for k in range(3):
                        held += columns[k, i] * pad.m[4][k, j]
                    slope[i, j] = ((1.0 if i == j else 0.0) - held) / soft
            return True
    return False
