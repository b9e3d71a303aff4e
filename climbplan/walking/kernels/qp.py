"""The pinned program's numbers, compiled: states by unknowns, objective, workspace rows.

Unknowns: forces of standing legs knot by knot (in units of `force_unit`), then free footholds (in
units of `foot_unit`). Everything is written into arrays that serve again.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.step import linearised

_FAR = 1e30
_ROUNDED = 0.05  # sine of a tilt


@compiled
def _states(
    after: Array,
    jacobian: Array,
    state: Array,
    force: Array,
    spots: Array,
    tilt: Array,
    foothold: IntArray,
    contact: BoolArray,
    begin: Array,
    force_unit: float,
    foot_unit: float,
    foot_column: int,
    offset: Array,
    by: Array,
) -> None:
    """States as offset + by z, eqs. (8.14) to (8.19) linearised about a point.

    after (N, 12) and jacobian (N, 12 + 6 L, 12) [of after by state, toes, forces]: at the point
    state (N + 1, 12), force (N, L, 3), spots (F, 2), whose heights rise by tilt (F, 2). Writes
    offset (N + 1, 12) and by (N + 1, 12, Z).
    """
    knots, legs = force.shape[0], force.shape[1]
    width = by.shape[2]
    for i in range(12):
        offset[0, i] = begin[i]
    by[0] = 0.0
    done = 0  # columns of forces so far
    for n in range(knots):
        J = jacobian[n]
        column = done
        for i in range(12):
            constant = after[n, i]
            for j in range(12):
                constant += J[j, i] * (offset[n, j] - state[n, j])
            row = by[n + 1, i]
            for c in range(width):
                row[c] = 0.0
            for j in range(12):
                a = J[j, i]
                if a != 0.0:
                    before = by[n, j]
                    for c in range(done):
                        row[c] += a * before[c]
                    for c in range(foot_column, width):
                        row[c] += a * before[c]
            column = done
            for leg in range(legs):
                if not contact[n, leg]:
                    continue
                for k in range(3):
                    slope = J[12 + 3 * (legs + leg) + k, i]
                    constant -= slope * force[n, leg, k]
                    row[column] = slope * force_unit
                    column += 1
                index = foothold[n, leg]
                if index >= 0:  # a free foothold moves the arm of its force
                    for k in range(2):
                        slope = J[12 + 3 * leg + k, i]
                        slope += J[12 + 3 * leg + 2, i] * tilt[index, k]
                        row[foot_column + 2 * index + k] += slope * foot_unit
                        constant -= slope * spots[index, k]
            offset[n + 1, i] = constant
        done = column


@compiled
def _add_square(
    weight: float,
    row: Array,
    residual: float,
    used: int,
    foot: int,
    hessian: Array,
    gradient: Array,
) -> None:
    """Add weight (residual + row z)^2 to the objective; columns `used` to `foot` are zero."""
    width = row.shape[0]
    w = 2.0 * weight
    for i in range(width):
        if used <= i < foot:
            continue
        a = w * row[i]
        if a == 0.0:
            continue
        gradient[i] += a * residual
        line = hessian[i]
        for j in range(i, used):
            line[j] += a * row[j]
        for j in range(max(i, foot), width):
            line[j] += a * row[j]


@compiled
def _objective(
    offset: Array,
    by: Array,
    wanted: Array,
    weight: Array,
    motion: float,
    columns: IntArray,
    foot: int,
    base: Array,
    ridge: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """Hessian (Z, Z) and gradient (Z,) of eq. (8.30) without its constant.

    wanted (N, 7) and weight (7,): of height, velocity and angles; columns (N + 1,): force columns
    that are in use up to each knot; base (Z, Z): what the forces themselves cost; ridge: curvature
    added along the diagonal, relative to it.
    """
    knots, width = wanted.shape[0], gradient.shape[0]
    hessian[:] = 0.0
    gradient[:] = 0.0
    step = np.empty(width)
    for n in range(1, knots + 1):
        used = columns[n]
        for k in range(7):
            residual = offset[n, 2 + k] - wanted[n - 1, k]
            _add_square(weight[k], by[n, 2 + k], residual, used, foot, hessian, gradient)
        if motion > 0.0:
            for k in range(3):
                for c in range(width):
                    step[c] = by[n, k, c] - by[n - 1, k, c]
                _add_square(
                    motion, step, offset[n, k] - offset[n - 1, k], used, foot, hessian, gradient
                )
    for i in range(width):
        for j in range(i, width):
            hessian[i, j] += base[i, j]
            hessian[j, i] = hessian[i, j]
        hessian[i, i] += ridge * (1.0 + abs(hessian[i, i]))


@compiled
def _stance_rows(
    center: Array,
    half: Array,
    margin: float,
    whole: bool,
    state: Array,
    toes: Array,
    spots: Array,
    tilt: Array,
    foothold: IntArray,
    contact: BoolArray,
    offset: Array,
    by: Array,
    foot_unit: float,
    foot_column: int,
    rows: Array,
    low: Array,
    high: Array,
) -> int:
    """Rows that keep standing toes in their boxes at knots 1 to N, eqs. (8.20), (8.21).

    whole: also those that lift at a knot, just before they do. tilt: as of `_states`. margin: of
    toes that are yet to be placed; nothing can be done about the others. Writes
    low <= rows z <= high from the first row on, and returns how many.
    """
    knots, legs = foothold.shape
    width = by.shape[2]
    R, turn = np.empty((3, 3)), np.empty((3, 3))
    count = 0
    for n in range(1, knots):
        rotation(state[n, 6:9], R)
        for leg in range(legs):
            at = n
            if not contact[n, leg]:
                if not (whole and contact[n - 1, leg]):
                    continue
                at = n - 1
            toe, index = toes[at, leg], foothold[at, leg]
            _turned(R, state[n, 6:9], toe - state[n, :3], turn)
            for i in range(3):
                row = rows[count]
                here = 0.0
                for j in range(3):
                    here += R[j, i] * (toe[j] - offset[n, j])
                    here += turn[i, j] * (offset[n, 6 + j] - state[n, 6 + j])
                for c in range(width):
                    value = 0.0
                    for j in range(3):
                        value += turn[i, j] * by[n, 6 + j, c] - R[j, i] * by[n, j, c]
                    row[c] = value
                if index >= 0:
                    for k in range(2):
                        slope = R[k, i] + R[2, i] * tilt[index, k]
                        row[foot_column + 2 * index + k] += slope * foot_unit
                        here -= slope * spots[index, k]
                room = half[i] - (margin if index >= 0 else 0.0)
                low[count] = center[leg, i] - room - here
                high[count] = center[leg, i] + room - here
                count += 1
    return count


@compiled
def _turned(R: Array, angles: Array, arm: Array, turn: Array) -> None:
    """Slopes (3, 3) of R^T arm by roll, pitch and yaw into turn."""
    sr, sp, sy = np.sin(angles[0]), np.sin(angles[1]), np.sin(angles[2])
    cr, cp, cy = np.cos(angles[0]), np.cos(angles[1]), np.cos(angles[2])
    x, y, z = arm[0], arm[1], arm[2]
    level = cy * x + sy * y  # along the heading
    turn[0, 0] = 0.0
    turn[1, 0] = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    turn[2, 0] = -(R[0, 1] * x + R[1, 1] * y + R[2, 1] * z)
    turn[0, 1] = -sp * level - cp * z
    turn[1, 1] = sr * (cp * level - sp * z)
    turn[2, 1] = cr * (cp * level - sp * z)
    for i in range(3):
        turn[i, 2] = R[0, i] * y - R[1, i] * x


@compiled
def _swing_rows(
    center: Array,
    half: Array,
    top: float,
    state: Array,
    height: Array,
    contact: BoolArray,
    offset: Array,
    by: Array,
    rows: Array,
    low: Array,
    high: Array,
) -> int:
    """Rows for lifted toes at knots 1 to N: some point of their boxes has their height.

    The height in the body is linear in where the toe is, so that the corner where it is least must
    not be too high, and that where it is most not too low. top: half the height of the boxes, less
    the margin. Writes as `_stance_rows`.
    """
    knots, legs = contact.shape
    width = by.shape[2]
    count = 0
    for n in range(1, knots):
        sr, sp = np.sin(state[n, 6]), np.sin(state[n, 7])
        cr, cp = np.cos(state[n, 6]), np.cos(state[n, 7])
        down = cr * cp
        # Rounded where the tilt changes its sign: any point of the box will do.
        along, across = np.tanh(sp / _ROUNDED), np.tanh(sr / _ROUNDED)
        for leg in range(legs):
            if contact[n, leg]:
                continue
            rise = height[n, leg] - state[n, 2]
            for side in (-1.0, 1.0):  # the corner of least height, then of most
                a = center[leg, 0] + side * half[0] * along
                b = center[leg, 1] - side * half[1] * across
                a_turn = side * half[0] * (1.0 - along**2) / _ROUNDED * cp
                b_turn = -side * half[1] * (1.0 - across**2) / _ROUNDED * cr
                depth = (rise + sp * a - sr * cp * b) / down
                by_height = -1.0 / down
                by_roll = (-cr * cp * b - sr * cp * b_turn + depth * sr * cp) / down
                by_pitch = (cp * a + sp * a_turn + sr * sp * b + depth * cr * sp) / down
                row = rows[count]
                for c in range(width):
                    row[c] = (
                        by_height * by[n, 2, c] + by_roll * by[n, 6, c] + by_pitch * by[n, 7, c]
                    )
                bound = center[leg, 2] - side * top - depth
                bound -= by_height * (offset[n, 2] - state[n, 2])
                bound -= by_roll * (offset[n, 6] - state[n, 6])
                bound -= by_pitch * (offset[n, 7] - state[n, 7])
                low[count] = -_FAR if side < 0 else bound
                high[count] = bound if side < 0 else _FAR
                count += 1
    return count


@compiled
def assembled(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    steps: Array,
    mean: bool,
    center: Array,
    half: Array,
    margin: float,
    whole: bool,
    contact: BoolArray,
    foothold: IntArray,
    tilt: Array,
    height: Array,
    begin: Array,
    state: Array,
    force: Array,
    spots: Array,
    toes: Array,
    wanted: Array,
    weight: Array,
    motion: float,
    base: Array,
    ridge: float,
    columns: IntArray,
    force_unit: float,
    foot_unit: float,
    foot_column: int,
    after: Array,
    jacobian: Array,
    offset: Array,
    by: Array,
    hessian: Array,
    gradient: Array,
    rows: Array,
    low: Array,
    high: Array,
) -> int:
    """Dynamics, objective and workspace rows about a point; how many rows there are.

    Arguments as of `linearised`, `_states`, `_objective`, `_stance_rows` and `_swing_rows`.
    """
    linearised(mass, gravity, inertia, inverse, steps, mean, state, toes, force, after, jacobian)
    _states(
        after, jacobian, state, force, spots, tilt, foothold, contact, begin, force_unit,
        foot_unit, foot_column, offset, by,
    )  # fmt: skip
    _objective(
        offset, by, wanted, weight, motion, columns, foot_column, base, ridge, hessian, gradient
    )
    count = _stance_rows(
        center, half, margin, whole, state, toes, spots, tilt, foothold, contact, offset, by,
        foot_unit, foot_column, rows, low, high,
    )  # fmt: skip
    return count + _swing_rows(
        center, half, half[2] - margin, state, height, contact, offset, by,
        rows[count:], low[count:], high[count:],
    )  # fmt: skip


@compiled
def force_cost(knot: IntArray, legs: int, factor: float, hessian: Array) -> None:
    """What differences of forces cost: factor (L delta - same knot) between forces, into (Z, Z).

    knot (K,): of each standing leg's force.
    """
    for i in range(len(knot)):
        for j in range(len(knot)):
            value = factor * ((legs if i == j else 0) - (1.0 if knot[i] == knot[j] else 0.0))
            for k in range(3):
                hessian[3 * i + k, 3 * j + k] = value


@compiled
def in_units(
    z: Array, contact: BoolArray, force_unit: float, foot_unit: float
) -> tuple[Array, Array]:
    """Forces (N, L, 3) [N] and free footholds (F, 2) [m] of unknowns (Z,); contact (N + 1, L)."""
    knots, legs = contact.shape[0] - 1, contact.shape[1]
    force, column = np.zeros((knots, legs, 3)), 0
    for n in range(knots):
        for leg in range(legs):
            if contact[n, leg]:
                for k in range(3):
                    force[n, leg, k] = z[column] * force_unit
                    column += 1
    return force, z[column:].copy().reshape(-1, 2) * foot_unit
