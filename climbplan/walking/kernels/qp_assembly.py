"""Numbers of the fixed-gait QP, compiled: affine states, objective and workspace rows.

The unknowns are forces of standing legs knot by knot (in units of `force_unit`), then free
footholds (in units of `foot_unit`). States are eliminated (condensing). Output arrays are reused.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.dynamics_step import linearise_steps
from climbplan.walking.kernels.parameters import (
    ForcedMotion,
    LinearisationPoint,
    QpBuffers,
    QpLayout,
    QpObjective,
    QpProblem,
    QpRows,
)

_FAR = 1e30
_SMOOTHING = 0.05  # sine of a tilt


@compiled
def _condense_states(problem: QpProblem, point: LinearisationPoint, buffers: QpBuffers) -> None:
    """Write states as offset + sensitivity z, eqs. (8.14) to (8.19) linearised about a point.

    The linearised steps are in `buffers.after` and `buffers.jacobian`.
    """
    layout, contact = problem.layout, problem.horizon.contact
    foothold, tilt, begin = (
        problem.placement.foothold,
        problem.placement.tilt,
        problem.horizon.start,
    )
    state, force, spots = point.state, point.force, point.spots
    force_unit, foot_unit, foot_column = layout.force_unit, layout.foot_unit, layout.foot_column
    after, jacobian = buffers.after, buffers.jacobian
    offset, sensitivity = buffers.states.offset, buffers.states.sensitivity
    knots, legs = force.shape[0], force.shape[1]
    width = sensitivity.shape[2]
    for i in range(12):
        offset[0, i] = begin[i]
    sensitivity[0] = 0.0
    done = 0  # columns of forces up to this knot
    for n in range(knots):
        J = jacobian[n]
        column = done
        for i in range(12):
            constant = after[n, i]
            for j in range(12):
                constant += J[j, i] * (offset[n, j] - state[n, j])
            row = sensitivity[n + 1, i]
            for c in range(width):
                row[c] = 0.0
            for j in range(12):
                a = J[j, i]
                if a != 0.0:
                    before = sensitivity[n, j]
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
                if index >= 0:  # a free foothold changes the moment arm of its force
                    for k in range(2):
                        slope = J[12 + 3 * leg + k, i]
                        slope += J[12 + 3 * leg + 2, i] * tilt[index, k]
                        row[foot_column + 2 * index + k] += slope * foot_unit
                        constant -= slope * spots[index, k]
            offset[n + 1, i] = constant
        done = column


@compiled
def _add_square(
    weight: float, row: Array, residual: float, nonzero: tuple[int, int], buffers: QpBuffers
) -> None:
    """Add weight (residual + row z)^2 to the objective.

    Columns of the row between the two of `nonzero` are zero.
    """
    end, foot = nonzero
    hessian, gradient = buffers.hessian, buffers.gradient
    width = row.shape[0]
    w = 2.0 * weight
    for i in range(width):
        if end <= i < foot:
            continue
        a = w * row[i]
        if a == 0.0:
            continue
        gradient[i] += a * residual
        line = hessian[i]
        for j in range(i, end):
            line[j] += a * row[j]
        for j in range(max(i, foot), width):
            line[j] += a * row[j]


@compiled
def _write_objective(objective: QpObjective, layout: QpLayout, buffers: QpBuffers) -> None:
    """Write Hessian (Z, Z) and gradient (Z,) of eq. (8.30) without its constant."""
    reference, weight, motion = objective.reference, objective.weight, objective.motion
    offset, sensitivity = buffers.states.offset, buffers.states.sensitivity
    hessian, gradient = buffers.hessian, buffers.gradient
    knots, width = reference.shape[0], gradient.shape[0]
    hessian[:] = 0.0
    gradient[:] = 0.0
    step = np.empty(width)
    for n in range(1, knots + 1):
        nonzero = (layout.force_columns[n], layout.foot_column)
        for k in range(7):
            residual = offset[n, 2 + k] - reference[n - 1, k]
            _add_square(weight[k], sensitivity[n, 2 + k], residual, nonzero, buffers)
        if motion > 0.0:
            for k in range(3):
                for c in range(width):
                    step[c] = sensitivity[n, k, c] - sensitivity[n - 1, k, c]
                residual = offset[n, k] - offset[n - 1, k]
                _add_square(motion, step, residual, nonzero, buffers)
    for i in range(width):
        for j in range(i, width):
            hessian[i, j] += objective.force_hessian[i, j]
            hessian[j, i] = hessian[i, j]
        hessian[i, i] += objective.ridge * (1.0 + abs(hessian[i, i]))


@compiled
def _write_stance_rows(
    problem: QpProblem, point: LinearisationPoint, toes: Array, buffers: QpBuffers
) -> int:
    """Write rows that keep standing toes in their boxes at knots 1 to N, eqs. (8.20), (8.21).

    With `workspace_over_stance` also toes that lift at a knot, just before they do. The margin
    counts for toes yet to be placed, as the others cannot change.

    Args:
        problem: the fixed-gait program.
        point: point of linearisation.
        toes: (N + 1, L, 3) its toes, world frame [m].
        buffers: output, from the first row on.

    Returns:
        The number of rows.
    """
    placement, layout, contact = problem.placement, problem.layout, problem.horizon.contact
    center, half = placement.workspace.center, placement.workspace.half
    foothold, tilt, state, spots = placement.foothold, placement.tilt, point.state, point.spots
    offset, sensitivity = buffers.states.offset, buffers.states.sensitivity
    rows, lower, upper = buffers.block.rows, buffers.block.lower, buffers.block.upper
    knots, legs = foothold.shape
    width = sensitivity.shape[2]
    R, turn = np.empty((3, 3)), np.empty((3, 3))
    count = 0
    for n in range(1, knots):
        rotation(state[n, 6:9], R)
        for leg in range(legs):
            stance_knot = n
            if not contact[n, leg]:
                if not (problem.horizon.workspace_over_stance and contact[n - 1, leg]):
                    continue
                stance_knot = n - 1
            toe, index = toes[stance_knot, leg], foothold[stance_knot, leg]
            _write_attitude_jacobian(R, state[n, 6:9], toe - state[n, :3], turn)
            for i in range(3):
                row = rows[count]
                constant = 0.0
                for j in range(3):
                    constant += R[j, i] * (toe[j] - offset[n, j])
                    constant += turn[i, j] * (offset[n, 6 + j] - state[n, 6 + j])
                for c in range(width):
                    value = 0.0
                    for j in range(3):
                        value += (
                            turn[i, j] * sensitivity[n, 6 + j, c] - R[j, i] * sensitivity[n, j, c]
                        )
                    row[c] = value
                if index >= 0:
                    for k in range(2):
                        slope = R[k, i] + R[2, i] * tilt[index, k]
                        row[layout.foot_column + 2 * index + k] += slope * layout.foot_unit
                        constant -= slope * spots[index, k]
                reach = half[i] - (layout.margin if index >= 0 else 0.0)
                lower[count] = center[leg, i] - reach - constant
                upper[count] = center[leg, i] + reach - constant
                count += 1
    return count


@compiled
def _write_attitude_jacobian(R: Array, angles: Array, arm: Array, turn: Array) -> None:
    """Write the derivatives (3, 3) of R^T arm by roll, pitch and yaw into turn."""
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
def _write_swing_rows(problem: QpProblem, state: Array, buffers: QpBuffers, block: QpRows) -> int:
    """Write rows for swinging toes at knots 1 to N: some point of their boxes has their height.

    The height in the body is linear in the toe's position. The corner of smallest height must
    therefore not be too high, and that of largest height not too low.

    Args:
        problem: the fixed-gait program.
        state: (N + 1, 12) point of linearisation.
        buffers: states by unknowns.
        block: output, from the first row on.

    Returns:
        The number of rows.
    """
    placement, contact = problem.placement, problem.horizon.contact
    center, half = placement.workspace.center, placement.workspace.half
    half_height, height = half[2] - problem.layout.margin, placement.height
    offset, sensitivity = buffers.states.offset, buffers.states.sensitivity
    rows, lower, upper = block.rows, block.lower, block.upper
    knots, legs = contact.shape
    width = sensitivity.shape[2]
    count = 0
    for n in range(1, knots):
        sr, sp = np.sin(state[n, 6]), np.sin(state[n, 7])
        cr, cp = np.cos(state[n, 6]), np.cos(state[n, 7])
        down = cr * cp
        # The corner changes smoothly with the sign of the tilt: any point of the box is admissible.
        along, across = np.tanh(sp / _SMOOTHING), np.tanh(sr / _SMOOTHING)
        for leg in range(legs):
            if contact[n, leg]:
                continue
            rise = height[n, leg] - state[n, 2]
            for side in (-1.0, 1.0):  # the corner of smallest height, then of largest
                a = center[leg, 0] + side * half[0] * along
                b = center[leg, 1] - side * half[1] * across
                a_turn = side * half[0] * (1.0 - along**2) / _SMOOTHING * cp
                b_turn = -side * half[1] * (1.0 - across**2) / _SMOOTHING * cr
                depth = (rise + sp * a - sr * cp * b) / down
                by_height = -1.0 / down
                by_roll = (-cr * cp * b - sr * cp * b_turn + depth * sr * cp) / down
                by_pitch = (cp * a + sp * a_turn + sr * sp * b + depth * cr * sp) / down
                row = rows[count]
                for c in range(width):
                    row[c] = (
                        by_height * sensitivity[n, 2, c]
                        + by_roll * sensitivity[n, 6, c]
                        + by_pitch * sensitivity[n, 7, c]
                    )
                bound = center[leg, 2] - side * half_height - depth
                bound -= by_height * (offset[n, 2] - state[n, 2])
                bound -= by_roll * (offset[n, 6] - state[n, 6])
                bound -= by_pitch * (offset[n, 7] - state[n, 7])
                lower[count] = -_FAR if side < 0 else bound
                upper[count] = bound if side < 0 else _FAR
                count += 1
    return count


@compiled
def assemble_qp(
    problem: QpProblem, point: LinearisationPoint, toes: Array, buffers: QpBuffers
) -> int:
    """Assemble the QP of a fixed gait about a point: states, objective and workspace rows.

    Args:
        problem: the fixed-gait program.
        point: point of linearisation.
        toes: (N + 1, L, 3) its toes, world frame [m].
        buffers: output.

    Returns:
        The number of workspace rows.
    """
    _linearise_motion(problem, point, toes, buffers)
    _condense_states(problem, point, buffers)
    _write_objective(problem.objective, problem.layout, buffers)
    return _write_workspace_rows(problem, point, toes, buffers)


@compiled
def assemble_state_rows(
    problem: QpProblem, point: LinearisationPoint, toes: Array, buffers: QpBuffers
) -> int:
    """Linearise the steps, and write the workspace rows over states that are unknowns themselves.

    Args:
        problem: the fixed-gait program; footholds begin at column 12.
        point: point of linearisation.
        toes: (N + 1, L, 3) its toes, world frame [m].
        buffers: output; `states` are the first 12 columns at every knot.

    Returns:
        The number of workspace rows.
    """
    _linearise_motion(problem, point, toes, buffers)
    return _write_workspace_rows(problem, point, toes, buffers)


@compiled
def _linearise_motion(
    problem: QpProblem, point: LinearisationPoint, toes: Array, buffers: QpBuffers
) -> None:
    """Write the states one interval after each knot's, and their derivatives."""
    motion = ForcedMotion(point.state, toes, point.force)
    horizon = problem.horizon
    linearise_steps(
        problem.body, horizon.steps, horizon.use_mean, motion, buffers.after, buffers.jacobian
    )


@compiled
def _write_workspace_rows(
    problem: QpProblem, point: LinearisationPoint, toes: Array, buffers: QpBuffers
) -> int:
    """Write the rows of standing toes, then those of swinging ones; return their number."""
    count = _write_stance_rows(problem, point, toes, buffers)
    block = buffers.block
    following = QpRows(block.rows[count:], block.lower[count:], block.upper[count:])
    return count + _write_swing_rows(problem, point.state, buffers, following)


@compiled
def write_force_cost(knot: IntArray, legs: int, factor: float, hessian: Array) -> None:
    """Write the Hessian of squared force differences: factor (L delta - same knot).

    Args:
        knot: (K,) knot of each standing leg's force.
        legs: number L of legs.
        factor: weight in units of the unknowns.
        hessian: (Z, Z) output.
    """
    for i in range(len(knot)):
        for j in range(len(knot)):
            value = factor * ((legs if i == j else 0) - (1.0 if knot[i] == knot[j] else 0.0))
            for k in range(3):
                hessian[3 * i + k, 3 * j + k] = value


@compiled
def split_unknowns(
    z: Array, contact: BoolArray, force_unit: float, foot_unit: float
) -> tuple[Array, Array]:
    """Return forces (N, L, 3) [N] and free footholds (F, 2) [m] of unknowns (Z,)."""
    knots, legs = contact.shape[0] - 1, contact.shape[1]
    force, column = np.zeros((knots, legs, 3)), 0
    for n in range(knots):
        for leg in range(legs):
            if contact[n, leg]:
                for k in range(3):
                    force[n, leg, k] = z[column] * force_unit
                    column += 1
    return force, z[column:].copy().reshape(-1, 2) * foot_unit
