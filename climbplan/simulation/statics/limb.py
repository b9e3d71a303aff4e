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
    _dot,
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
_STRAIGHT = 0.02  # of the cube of a limb's length, determinant below which its toe gives way
SOFTEST = 5e-6  # [m/N] of the toe of a straight limb: 0.15 mm at 30 N
_STILL = 5e-5  # [rad] after which one more step, which squares it, is the last
_CURVED = 0.02  # [rad] of a step below which the arcs of limbs count
_SPRUNG = 25  # tries with a toe that gives way


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
    if springs.soft[limb] > 0.0:
        return _sprung_toe(zero, limb, place, springs, angles, force, slope, pad)
    columns, axes, inverse, middle = pad.m[0], pad.m[1], pad.m[2], pad.m[3]
    half_way = pad.m[4]
    toe, missing, turned, torque, firm = pad.v[0], pad.v[1], pad.v[2], pad.v[3], pad.v[4]
    done = False
    for _ in range(_TRIES):
        _chain(zero, angles, columns, axes, toe)
        volume = _inverse(columns, inverse)
        springs.volume[limb] = volume
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
    _bent(limb, angles, springs, torque, firm)
    _times(inverse, torque, force)
    _arcs(columns, axes, force, firm, middle)
    _both_sides(inverse, middle, half_way, slope)
    return True


@compiled
def _bent(limb: int, angles: Array, springs: Springs, torque: Array, firm: Array) -> None:
    """Torques (3,) of joints at angles (3,) less the links' weight, and their stiffness (3,)."""
    for j in range(3):
        bend = angles[j] - springs.command[limb, j]
        half, loose = springs.half[limb, j], springs.loose[limb, j]
        torque[j] = _pushes(bend, half, loose, springs.stiffness[limb, j])
        firm[j] = springs.stiffness[limb, j] if abs(bend) > half else loose
        torque[j] -= springs.weight[limb, j]


@compiled
def _arcs(columns: Array, axes: Array, force: Array, firm: Array, middle: Array) -> None:
    """middle (3, 3) = k - f . d2p / dtheta_i dtheta_j, the latter axis_i x column_j for i <= j."""
    f0, f1, f2 = force[0], force[1], force[2]
    for j in range(3):
        c0, c1, c2 = columns[j, 0], columns[j, 1], columns[j, 2]
        # f . (axis x column) = axis . (column x f)
        t0, t1, t2 = c1 * f2 - c2 * f1, c2 * f0 - c0 * f2, c0 * f1 - c1 * f0
        for i in range(j):
            lost = axes[i, 0] * t0 + axes[i, 1] * t1 + axes[i, 2] * t2
            middle[i, j] = middle[j, i] = -lost
        middle[j, j] = firm[j] - (axes[j, 0] * t0 + axes[j, 1] * t1 + axes[j, 2] * t2)


@compiled
def _softness(zero: Array, volume: float) -> float:
    """Compliance of a limb's toe [m/N]: 0 but where the limb is nearly straight.

    volume: determinant of its Jacobian [m^3].
    """
    length = 0.0
    for j in range(3):
        piece = 0.0
        for a in range(3):
            piece += (zero[4 + j, a] - zero[3 + j, a]) ** 2
        length += np.sqrt(piece)
    part = max(0.0, 1.0 - abs(volume) / (_STRAIGHT * length**3))
    return float(SOFTEST * part * part)


@compiled
def _volume(c: Array) -> float:
    """Determinant of a Jacobian's columns (3, 3)."""
    volume = c[0, 0] * (c[1, 1] * c[2, 2] - c[1, 2] * c[2, 1])
    volume += c[0, 1] * (c[1, 2] * c[2, 0] - c[1, 0] * c[2, 2])
    volume += c[0, 2] * (c[1, 0] * c[2, 1] - c[1, 1] * c[2, 0])
    return float(volume)


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
    columns, axes, inverse, middle = pad.m[0], pad.m[1], pad.m[2], pad.m[3]
    toe, torque, firm, off, turned = pad.v[0], pad.v[3], pad.v[4], pad.v[1], pad.v[2]
    last = 1.0
    for _ in range(_SPRUNG):
        _chain(zero, angles, columns, axes, toe)
        for i in range(3):
            force[i] = (place[i] - toe[i]) / soft
        _bent(limb, angles, springs, torque, firm)
        curved = last < _CURVED
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
        part = 1.0 if last <= _TURNED else _TURNED / last
        for j in range(3):
            angles[j] += part * turned[j]
        if curved and last < _STILL:
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
