"""A limb of n joints in the body frame: where its toe is, what its joints push, how it curves.

Joints are springs about commands, with play: motors turn a joint by torque / stiffness, and beyond
that it is free within its play.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.tuples import Springs

LOOSE = 0.2  # of a motor's stiffness left within the play, which is wider by as much
_STRAIGHT = 0.02  # of the cube of a limb's length, volume below which its toe gives way
TURNED = 0.15  # [rad] of a joint in one step of a search for its angles at most
STILL = 5e-5  # [rad] after which one more step, which squares it, is the last
CURVED = 0.02  # [rad] of a step below which the arcs of limbs count
SQUASHED = 1e-7  # [m^3] volume below which a limb counts as singular
SOFTEST = 5e-6  # [m/N] of the toe of a straight limb: 0.15 mm at 30 N


@compiled
def _chain(zero: Array, angles: Array, columns: Array, axes: Array, toe: Array) -> None:
    """Toe (3,), Jacobian columns (n, 3: joint, axis) and joint axes (n, 3) at angles (n,).

    zero: (2n + 1, 3) axes and joints at zero angles, and the toe, body frame, and of limbs with
    joints that slide (3n + 1, 3), the directions of these. Columns hold the places of the joints
    first.
    """
    n = len(angles)
    slides = len(zero) > 2 * n + 1
    # Rotation of the links so far, row by row
    a00, a01, a02 = 1.0, 0.0, 0.0
    a10, a11, a12 = 0.0, 1.0, 0.0
    a20, a21, a22 = 0.0, 0.0, 1.0
    x, y, z = zero[n, 0], zero[n, 1], zero[n, 2]
    for j in range(n):
        columns[j, 0], columns[j, 1], columns[j, 2] = x, y, z
        p, q, r = zero[j, 0], zero[j, 1], zero[j, 2]
        u = a00 * p + a01 * q + a02 * r
        v = a10 * p + a11 * q + a12 * r
        w = a20 * p + a21 * q + a22 * r
        axes[j, 0], axes[j, 1], axes[j, 2] = u, v, w
        # Turned about the axis as it now is (Rodrigues): each column c by
        # c cos + (axis x c) sin + axis (axis . c) (1 - cos)
        # and not at all by a joint that slides, whose axis is zero
        co, si = 1.0, 0.0
        if u != 0.0 or v != 0.0 or w != 0.0:
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
        p = zero[n + 1 + j, 0] - zero[n + j, 0]
        q = zero[n + 1 + j, 1] - zero[n + j, 1]
        r = zero[n + 1 + j, 2] - zero[n + j, 2]
        if slides:
            # Rotations so far are those of the link before, as a joint that slides does not turn
            e, f, g = zero[2 * n + 1 + j, 0], zero[2 * n + 1 + j, 1], zero[2 * n + 1 + j, 2]
            if e != 0.0 or f != 0.0 or g != 0.0:
                axes[j, 0] = a00 * e + a01 * f + a02 * g
                axes[j, 1] = a10 * e + a11 * f + a12 * g
                axes[j, 2] = a20 * e + a21 * f + a22 * g
            p += angles[j] * e
            q += angles[j] * f
            r += angles[j] * g
        x += a00 * p + a01 * q + a02 * r
        y += a10 * p + a11 * q + a12 * r
        z += a20 * p + a21 * q + a22 * r
    toe[0], toe[1], toe[2] = x, y, z
    for j in range(n):
        p, q, r = x - columns[j, 0], y - columns[j, 1], z - columns[j, 2]
        u, v, w = axes[j, 0], axes[j, 1], axes[j, 2]
        if zero[j, 0] == 0.0 and zero[j, 1] == 0.0 and zero[j, 2] == 0.0:  # it slides
            columns[j, 0], columns[j, 1], columns[j, 2] = u, v, w
            axes[j, 0], axes[j, 1], axes[j, 2] = 0.0, 0.0, 0.0
            continue
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
    """Where the joints (n,) of a limb in the air rest: links hang at the ends of the play."""
    for j in range(len(out)):
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
def _bent(limb: int, angles: Array, springs: Springs, torque: Array, firm: Array) -> None:
    """Torques (n,) of joints at angles (n,) less the links' weight, and their stiffness (n,)."""
    for j in range(len(angles)):
        bend = angles[j] - springs.command[limb, j]
        half, loose = springs.half[limb, j], springs.loose[limb, j]
        torque[j] = _pushes(bend, half, loose, springs.stiffness[limb, j])
        firm[j] = springs.stiffness[limb, j] if abs(bend) > half else loose
        torque[j] -= springs.weight[limb, j]


@compiled
def _arcs(columns: Array, axes: Array, force: Array, firm: Array, middle: Array) -> None:
    """middle (n, n) = k - f . d2p / dtheta_i dtheta_j, the latter axis_i x column_j for i <= j."""
    f0, f1, f2 = force[0], force[1], force[2]
    for j in range(len(firm)):
        c0, c1, c2 = columns[j, 0], columns[j, 1], columns[j, 2]
        # f . (axis x column) = axis . (column x f)
        t0, t1, t2 = c1 * f2 - c2 * f1, c2 * f0 - c0 * f2, c0 * f1 - c1 * f0
        for i in range(j):
            lost = axes[i, 0] * t0 + axes[i, 1] * t1 + axes[i, 2] * t2
            middle[i, j] = middle[j, i] = -lost
        middle[j, j] = firm[j] - (axes[j, 0] * t0 + axes[j, 1] * t1 + axes[j, 2] * t2)


@compiled
def _softness(zero: Array, n: int, volume: float) -> float:
    """Compliance of the toe of a limb of n joints [m/N]: 0 but where it is nearly straight.

    volume: of its Jacobian [m^3].
    """
    length = 0.0
    for j in range(n):
        piece = 0.0
        for a in range(3):
            piece += (zero[n + 1 + j, a] - zero[n + j, a]) ** 2
        length += np.sqrt(piece)
    part = max(0.0, 1.0 - abs(volume) / (_STRAIGHT * length**3))
    return float(SOFTEST * part * part)


@compiled
def _volume(c: Array) -> float:
    """How far from singular a Jacobian's columns (n, 3) are [m^3]: of three the determinant.

    Of more the root of the sum of the squares of all determinants of three (Cauchy and Binet).
    """
    total, n = 0.0, len(c)
    for i in range(n):
        for j in range(i + 1, n):
            for k in range(j + 1, n):
                volume = c[i, 0] * (c[j, 1] * c[k, 2] - c[j, 2] * c[k, 1])
                volume += c[i, 1] * (c[j, 2] * c[k, 0] - c[j, 0] * c[k, 2])
                volume += c[i, 2] * (c[j, 0] * c[k, 1] - c[j, 1] * c[k, 0])
                if n == 3:
                    return float(volume)
                total += volume * volume
    return float(np.sqrt(total))
