"""One limb of three joints in the body frame: its toe, its force, and how the force changes.

Joints are springs about commands, with play: motors turn a joint by torque / stiffness, and beyond
that it is free within its play. Of a toe held at
place p the contact force is f = J^-T (k play(theta - command) - weight), by p it changes by
J^-T (k - f . d2p/dtheta2) J^-1.
"""

from __future__ import annotations

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.simulation.statics.compiling import compiled
from climbplan.simulation.statics.small_algebra import (
    _both_sides,
    _inverse,
    _times,
    _transposed_times,
)
from climbplan.simulation.statics.tuples import Pad, Springs

LOOSE = 0.2  # of a motor's stiffness left within the play, which is wider by as much
_TURNED = 0.15  # [rad] of a joint in one step of the inverse kinematics at most
_REACHED = 3e-5  # [m] after which one more step, which squares it, is the last
_TRIES = 12
_SQUASHED = 1e-7  # [m^3] determinant below which a limb counts as singular


@compiled
def _chain(zero: Array, angles: Array, columns: Array, axes: Array, toe: Array) -> None:
    """Toe (3,), Jacobian columns (3, 3: joint, axis) and joint axes (3, 3) at angles (3,).

    zero: (7, 3) three axes and three joints at zero angles, and the toe, body frame. Columns hold
    the places of the joints first.
    """
    # Rotation of the links so far, row by row
    a00, a01, a02 = 1.0, 0.0, 0.0
    a10, a11, a12 = 0.0, 1.0, 0.0
    a20, a21, a22 = 0.0, 0.0, 1.0
    x, y, z = zero[3, 0], zero[3, 1], zero[3, 2]
    for j in range(3):
        columns[j, 0], columns[j, 1], columns[j, 2] = x, y, z
        p, q, r = zero[j, 0], zero[j, 1], zero[j, 2]
        u = a00 * p + a01 * q + a02 * r
        v = a10 * p + a11 * q + a12 * r
        w = a20 * p + a21 * q + a22 * r
        axes[j, 0], axes[j, 1], axes[j, 2] = u, v, w
        # Turned about the axis as it now is (Rodrigues): each column c by
        # c cos + (axis x c) sin + axis (axis . c) (1 - cos)
        co, si = np.cos(angles[j]), np.sin(angles[j])
        k = 1.0 - co
        d = k * (u * a00 + v * a10 + w * a20)
        a00, a10, a20 = (
            a00 * co + (v * a20 - w * a10) * si + u * d,
            a10 * co + (w * a00 - u * a20) * si + v * d,
            a20 * co + (u * a10 - v * a00) * si + w * d,
        )
        d = k * (u * a01 + v * a11 + w * a21)
        a01, a11, a21 = (
            a01 * co + (v * a21 - w * a11) * si + u * d,
            a11 * co + (w * a01 - u * a21) * si + v * d,
            a21 * co + (u * a11 - v * a01) * si + w * d,
        )
        d = k * (u * a02 + v * a12 + w * a22)
        a02, a12, a22 = (
            a02 * co + (v * a22 - w * a12) * si + u * d,
            a12 * co + (w * a02 - u * a22) * si + v * d,
            a22 * co + (u * a12 - v * a02) * si + w * d,
        )
        p = zero[4 + j, 0] - zero[3 + j, 0]
        q = zero[4 + j, 1] - zero[3 + j, 1]
        r = zero[4 + j, 2] - zero[3 + j, 2]
        x += a00 * p + a01 * q + a02 * r
        y += a10 * p + a11 * q + a12 * r
        z += a20 * p + a21 * q + a22 * r
    toe[0], toe[1], toe[2] = x, y, z
    for j in range(3):
        p, q, r = x - columns[j, 0], y - columns[j, 1], z - columns[j, 2]
        u, v, w = axes[j, 0], axes[j, 1], axes[j, 2]
        columns[j, 0], columns[j, 1], columns[j, 2] = v * r - w * q, w * p - u * r, u * q - v * p


@compiled
def _pushes(bend: float, half: float, loose: float, firm: float) -> float:
    """Torque of a joint bent from its command, `half` of its play to either side.

    Within the play a part of the stiffness is left (`loose`), beyond it there is all (`firm`).
    """
    if bend > half:
        return loose * half + firm * (bend - half)
    if bend < -half:
        return -loose * half + firm * (bend + half)
    return loose * bend


@compiled
def _free_angles(limb: int, springs: Springs, out: Array) -> None:
    """Where the joints of a limb in the air rest: its links hang at the ends of the play."""
    for j in range(3):
        weight, half = springs.weight[limb, j], springs.half[limb, j]
        loose, firm = springs.loose[limb, j], springs.stiffness[limb, j]
        most = loose * half
        if weight > most:
            bend = half + (weight - most) / firm
        elif weight < -most:
            bend = -half + (weight + most) / firm
        else:
            bend = weight / loose
        out[j] = springs.command[limb, j] + bend


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

    zero: (7, 3) of the limb of that number.

    False if the place is not reached.
    """
    columns, axes, inverse, middle = pad.m[0], pad.m[1], pad.m[2], pad.m[3]
    half_way = pad.m[4]
    toe, missing, turned, torque, firm = pad.v[0], pad.v[1], pad.v[2], pad.v[3], pad.v[4]
    done = False
    for _ in range(_TRIES):
        _chain(zero, angles, columns, axes, toe)
        volume = _inverse(columns, inverse)
        if not abs(volume) > _SQUASHED:
            return False
        for i in range(3):
            missing[i] = place[i] - toe[i]
        _transposed_times(inverse, missing, turned)
        longest = max(abs(turned[0]), abs(turned[1]), abs(turned[2]))
        part = 1.0 if longest <= _TURNED else _TURNED / longest
        for j in range(3):
            angles[j] += part * turned[j]
        if abs(missing[0]) + abs(missing[1]) + abs(missing[2]) < _REACHED:
            done = True
            break
    if not done:
        return False
    for j in range(3):
        bend = angles[j] - springs.command[limb, j]
        half, loose = springs.half[limb, j], springs.loose[limb, j]
        torque[j] = _pushes(bend, half, loose, springs.stiffness[limb, j])
        firm[j] = springs.stiffness[limb, j] if abs(bend) > half else loose
        torque[j] -= springs.weight[limb, j]
    _times(inverse, torque, force)
    # k - f . d2p / dtheta_i dtheta_j = axis_i x column_j for i <= j
    f0, f1, f2 = force[0], force[1], force[2]
    for j in range(3):
        c0, c1, c2 = columns[j, 0], columns[j, 1], columns[j, 2]
        # f . (axis x column) = axis . (column x f)
        t0, t1, t2 = c1 * f2 - c2 * f1, c2 * f0 - c0 * f2, c0 * f1 - c1 * f0
        for i in range(j):
            lost = axes[i, 0] * t0 + axes[i, 1] * t1 + axes[i, 2] * t2
            middle[i, j] = middle[j, i] = -lost
        middle[j, j] = firm[j] - (axes[j, 0] * t0 + axes[j, 1] * t1 + axes[j, 2] * t2)
    _both_sides(inverse, middle, half_way, slope)
    return True
