"""The compiled iteration of `chain_inverse.py`: damped Gauss-Newton steps, toe by toe."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.compiling import create_compiler

REACHED = 1e-9  # [m] of a toe from its place
_MAX_ITERATIONS = 80
_MAX_TOE_STEP = 0.06  # [m] of the straight line in one step
_DAMPING = 1e-5  # of the Jacobian's largest singular value, squared in the step
_MAX_JOINT_STEP = 0.5  # [rad]
_STEP_TOLERANCE = 1e-10  # [rad] of null-space motion
_CURVATURE_RADIUS = 0.02  # [m] about the target, in which the curvature counts
_MIN_CURVATURE = 0.2
_REGULARISATION = 1e-9  # of the Jacobian's square
_PROGRESS_RATIO = 0.99  # of the smallest distance so far, which counts as progress
_MAX_STALLED = 12  # steps without progress, for toes that the limb is too short for

compiled = create_compiler(Path(__file__).parent, "chain_kernel.py")


@compiled
def solve_toes(
    joints: Array,
    axes: Array,
    toe_zero: Array,
    slides: Array,
    drive: Array,
    moves: BoolArray,
    posture: Array,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
    is_too_far: BoolArray,
) -> tuple[Array, Array]:
    """Solve the inverse kinematics of F toes; return angles (F, J) and distances left (F,).

    Args:
        joints: (N, J, 3) points on the joint axes at zero angles [m].
        axes: (N, J, 3) unit axes, zero of joints that do not turn.
        toe_zero: (N, 3) [m].
        slides: (N, J, 3) directions of joints that slide, in units of angles; else zero.
        drive: (N, J, J) motions of joints by angles.
        moves: (N, J) whether an angle moves anything.
        posture: (N, J) angles to stay nearest to.
        limbs: (F,) limb of each toe.
        toes: (F, 3) [m].
        lower: (F, J) bounds.
        upper: (F, J) bounds.
        is_too_far: (F,) whether a limb is too short for the toe.
    """
    count, size = len(toes), joints.shape[1]
    angles = np.empty((count, size))
    missing = np.empty(count)
    columns, jacobian = np.empty((size, 3)), np.empty((3, size))
    axis, toe, step, best = np.empty((size, 3)), np.empty(3), np.empty(size), np.empty(size)
    motion, error, offset = np.empty(size), np.empty(3), np.empty(size)
    metric = np.empty((size, size))
    for f in range(count):
        limb = limbs[f]
        q = angles[f]
        for j in range(size):
            q[j] = min(max(posture[limb, j], lower[f, j]), upper[f, j])
            best[j] = q[j]
        if not np.isfinite(toes[f]).all():
            missing[f] = np.inf
            continue
        home = q.copy()
        least, reference, stalled = np.inf, np.inf, 0
        patience = _MAX_STALLED if is_too_far[f] else _MAX_ITERATIONS
        for _ in range(_MAX_ITERATIONS):
            _compute_pose(
                joints[limb], axes[limb], toe_zero[limb], slides[limb], drive[limb], q,
                motion, axis, columns, toe,
            )  # fmt: skip
            distance = 0.0
            for i in range(3):
                error[i] = toes[f, i] - toe[i]
                distance += error[i] ** 2
                for j in range(size):
                    total = 0.0
                    for k in range(size):
                        total += columns[k, i] * drive[limb, k, j]
                    jacobian[i, j] = total
            distance = np.sqrt(distance)
            if distance < least:
                least = distance
                best[:] = q
            if distance < _PROGRESS_RATIO * reference:
                reference, stalled = distance, 0
            elif distance < REACHED:
                stalled = 0
            else:
                stalled += 1
            scale = min(1.0, _MAX_TOE_STEP / max(distance, 1e-300))
            for i in range(3):
                error[i] *= scale
            for j in range(size):
                offset[j] = q[j] - home[j]
            _compute_metric(
                jacobian, axis, columns, drive[limb], offset, distance < _CURVATURE_RADIUS, metric
            )
            _compute_step(jacobian, error, offset, metric, moves[limb], q, lower[f], upper[f], step)
            longest = 0.0
            for j in range(size):
                longest = max(longest, abs(step[j]))
                q[j] = min(max(q[j] + step[j], lower[f, j]), upper[f, j])
            if (distance < REACHED / 10 and longest < _STEP_TOLERANCE) or stalled >= patience:
                break
        _compute_pose(
            joints[limb], axes[limb], toe_zero[limb], slides[limb], drive[limb], q,
            motion, axis, columns, toe,
        )  # fmt: skip
        left = np.sqrt(((toes[f] - toe) ** 2).sum())
        # Damped Gauss-Newton steps oscillate where a toe is out of reach
        if left > REACHED and least < left and least > REACHED:
            q[:] = best
            left = least
        missing[f] = left
    return angles, missing


@compiled
def _compute_pose(
    joints: Array,
    axes: Array,
    toe_zero: Array,
    slides: Array,
    drive: Array,
    q: Array,
    motion: Array,
    axis: Array,
    columns: Array,
    toe: Array,
) -> None:
    """Compute joint axes (J, 3), toe (3,) and its velocities by each joint's own speed (J, 3)."""
    size = len(q)
    for j in range(size):
        total = 0.0
        for k in range(size):
            total += drive[j, k] * q[k]
        motion[j] = total
    rotation = np.eye(3)
    origin = joints[0].copy()
    place = np.empty((size, 3))
    slide = np.zeros((size, 3))
    turned = np.empty((3, 3))
    for j in range(size):
        for i in range(3):
            place[j, i] = origin[i]
            axis[j, i] = (
                rotation[i, 0] * axes[j, 0]
                + rotation[i, 1] * axes[j, 1]
                + rotation[i, 2] * axes[j, 2]
            )
        x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            s, c = np.sin(motion[j]), 1.0 - np.cos(motion[j])
            # Rodrigues
            turn = np.array([
                [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
                [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
                [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
            ])  # fmt: skip
            for i in range(3):
                for k in range(3):
                    turned[i, k] = (
                        rotation[i, 0] * turn[0, k]
                        + rotation[i, 1] * turn[1, k]
                        + rotation[i, 2] * turn[2, k]
                    )
            for i in range(3):
                for k in range(3):
                    rotation[i, k] = turned[i, k]
        for i in range(3):
            along = 0.0
            for k in range(3):
                following = joints[j + 1, k] if j + 1 < size else toe_zero[k]
                along += rotation[i, k] * (following - joints[j, k] + motion[j] * slides[j, k])
                slide[j, i] += rotation[i, k] * slides[j, k]
            origin[i] += along
    for i in range(3):
        toe[i] = origin[i]
    for j in range(size):
        dx, dy, dz = toe[0] - place[j, 0], toe[1] - place[j, 1], toe[2] - place[j, 2]
        columns[j, 0] = axis[j, 1] * dz - axis[j, 2] * dy + slide[j, 0]
        columns[j, 1] = axis[j, 2] * dx - axis[j, 0] * dz + slide[j, 1]
        columns[j, 2] = axis[j, 0] * dy - axis[j, 1] * dx + slide[j, 2]


@compiled
def _compute_metric(
    jacobian: Array,
    axis: Array,
    columns: Array,
    drive: Array,
    offset: Array,
    is_near: bool,
    metric: Array,
) -> None:
    """Compute the Hessian (J, J) of the Lagrangian of |q - q0|^2 / 2 with the toe fixed.

    Its eigenvalues are at least `_MIN_CURVATURE`. Without it, null-space steps overshoot where
    limbs are nearly stretched. Where not `is_near` it is the identity.
    """
    size = len(offset)
    for i in range(size):
        for j in range(size):
            metric[i, j] = 1.0 if i == j else 0.0
    if size == 3 or not is_near:
        return
    square = jacobian @ jacobian.T
    trace = square[0, 0] + square[1, 1] + square[2, 2]
    for i in range(3):
        square[i, i] += _REGULARISATION * trace
    multiplier = np.empty((3, 1))
    for i in range(3):
        multiplier[i, 0] = (jacobian[i] * offset).sum()
    _solve_in_place(square, multiplier)
    curvature = np.zeros((size, size))
    for i in range(size):
        for j in range(i, size):
            total = (
                multiplier[0, 0] * (axis[i, 1] * columns[j, 2] - axis[i, 2] * columns[j, 1])
                + multiplier[1, 0] * (axis[i, 2] * columns[j, 0] - axis[i, 0] * columns[j, 2])
                + multiplier[2, 0] * (axis[i, 0] * columns[j, 1] - axis[i, 1] * columns[j, 0])
            )
            curvature[i, j] = curvature[j, i] = total
    curvature = np.eye(size) - drive.T @ curvature @ drive
    value, vector = np.linalg.eigh(curvature)
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += vector[i, k] * max(value[k], _MIN_CURVATURE) * vector[j, k]
            metric[i, j] = total


@compiled
def _compute_step(
    jacobian: Array,
    error: Array,
    offset: Array,
    metric: Array,
    moves: BoolArray,
    q: Array,
    lower: Array,
    upper: Array,
    step: Array,
) -> None:
    """Compute the joint step (J,) towards the toe's target and, in the null space, towards home.

    Joints that a step would take beyond a bound are put on it, and the others step again: an
    active set. Damping is that of Levenberg and Marquardt.
    """
    size = len(q)
    free = moves.copy()
    fixed = np.zeros(size)
    for _ in range(size):
        masked = np.empty((size, size))
        right = np.empty((size, 4))
        for j in range(size):
            for k in range(size):
                masked[j, k] = metric[j, k] if free[j] and free[k] else (1.0 if j == k else 0.0)
            for i in range(3):
                right[j, i] = jacobian[i, j] if free[j] else 0.0
            right[j, 3] = -offset[j] if free[j] else 0.0
        _solve_in_place(masked, right)
        square = np.zeros((3, 3))
        residual = np.empty((3, 1))
        for i in range(3):
            residual[i, 0] = error[i]
            for j in range(size):
                residual[i, 0] -= jacobian[i, j] * fixed[j]
                if free[j]:
                    residual[i, 0] -= jacobian[i, j] * right[j, 3]
                    for k in range(3):
                        square[i, k] += jacobian[i, j] * right[j, k]
        damping = _DAMPING**2 * (square[0, 0] + square[1, 1] + square[2, 2]) + 1e-30
        damped = square.copy()
        for i in range(3):
            damped[i, i] += damping
        multiplier = residual.copy()
        again = damped.copy()
        _solve_in_place(damped, multiplier)
        # One refinement for the residual of damping, or the pull home would keep the toe off target
        for i in range(3):
            for k in range(3):
                residual[i, 0] -= square[i, k] * multiplier[k, 0]
        _solve_in_place(again, residual)
        longest = 0.0
        for j in range(size):
            step[j] = right[j, 3]
            for k in range(3):
                step[j] += right[j, k] * (multiplier[k, 0] + residual[k, 0])
            longest = max(longest, abs(step[j]))
        scale = min(1.0, _MAX_JOINT_STEP / max(longest, 1e-300))
        is_beyond = False
        for j in range(size):
            step[j] = step[j] * scale if free[j] else 0.0
            if free[j] and (step[j] < lower[j] - q[j] or step[j] > upper[j] - q[j]):
                fixed[j] = min(max(step[j], lower[j] - q[j]), upper[j] - q[j])
                free[j] = False
                is_beyond = True
        if not is_beyond:
            break
    for j in range(size):
        if not free[j]:
            step[j] = fixed[j]


@compiled
def _solve_in_place(matrix: Array, right: Array) -> None:
    """Solve matrix x = right by Gaussian elimination with row pivoting, in place of `right`."""
    size, columns = right.shape
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(columns):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k, size):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(columns):
                right[i, j] -= factor * right[k, j]
    for k in range(size - 1, -1, -1):
        for j in range(columns):
            for i in range(k + 1, size):
                right[k, j] -= matrix[k, i] * right[i, j]
            right[k, j] /= matrix[k, k]
