"""The compiled iteration of `chain_inverse.py`: damped Gauss-Newton steps, toe by toe."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

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


class ChainTable(NamedTuple):
    """Chains of J joints at zero angles: of N limbs, with a leading axis, or of one."""

    joints: Array  # (J, 3) points on the joint axes [m]
    axes: Array  # (J, 3) unit axes, zero of joints that do not turn
    toe: Array  # (3,) [m]
    slides: Array  # (J, 3) directions of joints that slide, in units of angles; else zero
    drive: Array  # (J, J) motions of joints by angles
    moves: BoolArray  # (J,) whether an angle moves anything
    posture: Array  # (J,) angles to stay nearest to


class ChainState(NamedTuple):
    """A limb at some angles."""

    axes: Array  # (J, 3) unit axes, zero of joints that do not turn
    columns: Array  # (J, 3) velocities of the toe by each joint's own speed
    toe: Array  # (3,) [m]
    jacobian: Array  # (3, J) of the toe by the angles


class StepTarget(NamedTuple):
    """What a step of the joints is to reach, and its bounds."""

    error: Array  # (3,) of the toe [m]
    offset: Array  # (J,) of the angles from those to stay nearest to
    metric: Array  # (J, J) Hessian of the objective
    down: Array  # (J,) largest step to the lower bounds, negative
    up: Array  # (J,) largest step to the upper bounds


@compiled
def solve_toes(
    chains: ChainTable,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
    is_too_far: BoolArray,
) -> tuple[Array, Array]:
    """Solve the inverse kinematics of F toes; return angles (F, J) and distances left (F,).

    Args:
        chains: The N limbs.
        limbs: (F,) limb of each toe.
        toes: (F, 3) [m].
        lower: (F, J) bounds.
        upper: (F, J) bounds.
        is_too_far: (F,) whether a limb is too short for the toe.
    """
    count, size = lower.shape
    angles, missing = np.empty((count, size)), np.empty(count)
    for f in range(count):
        n = limbs[f]
        chain = ChainTable(
            chains.joints[n], chains.axes[n], chains.toe[n],
            chains.slides[n], chains.drive[n], chains.moves[n], chains.posture[n],
        )  # fmt: skip
        for j in range(size):
            angles[f, j] = min(max(chain.posture[j], lower[f, j]), upper[f, j])
        missing[f] = np.inf
        if np.isfinite(toes[f]).all():
            patience = _MAX_STALLED if is_too_far[f] else _MAX_ITERATIONS
            missing[f] = _solve_toe(chain, toes[f], lower[f], upper[f], patience, angles[f])
    return angles, missing


@compiled
def _solve_toe(
    chain: ChainTable, toe: Array, lower: Array, upper: Array, patience: int, q: Array
) -> float:
    """Move angles q (J,) in place until the toe is at its place; return the distance left [m]."""
    size = len(q)
    home, best = q.copy(), q.copy()
    pose = ChainState(np.empty((size, 3)), np.empty((size, 3)), np.empty(3), np.empty((3, size)))
    step, error, metric = np.empty(size), np.empty(3), np.empty((size, size))
    smallest, reference, stalled = np.inf, np.inf, 0
    for _ in range(_MAX_ITERATIONS):
        _compute_pose(chain, q, pose)
        distance = np.sqrt(((toe - pose.toe) ** 2).sum())
        if distance < smallest:
            smallest = distance
            for j in range(size):
                best[j] = q[j]
        if distance < _PROGRESS_RATIO * reference:
            reference, stalled = distance, 0
        elif distance < REACHED:
            stalled = 0
        else:
            stalled += 1
        scale = min(1.0, _MAX_TOE_STEP / max(distance, 1e-300))
        for i in range(3):
            error[i] = scale * (toe[i] - pose.toe[i])
        target = StepTarget(error, q - home, metric, lower - q, upper - q)
        _compute_metric(chain, pose, target.offset, distance < _CURVATURE_RADIUS, metric)
        _compute_step(chain, pose, target, step)
        longest = 0.0
        for j in range(size):
            longest = max(longest, abs(step[j]))
            q[j] = min(max(q[j] + step[j], lower[j]), upper[j])
        if (distance < REACHED / 10 and longest < _STEP_TOLERANCE) or stalled >= patience:
            break
    _compute_pose(chain, q, pose)
    distance = np.sqrt(((toe - pose.toe) ** 2).sum())
    # Damped Gauss-Newton steps oscillate where a toe is out of reach
    if distance > REACHED and smallest < distance and smallest > REACHED:
        for j in range(size):
            q[j] = best[j]
        distance = smallest
    return distance


@compiled
def _compute_pose(chain: ChainTable, q: Array, pose: ChainState) -> None:
    """Compute the pose of a limb at angles (J,), in place."""
    size = len(q)
    rotation = np.eye(3)
    origin = chain.joints[0].copy()
    places, slides = np.empty((size, 3)), np.zeros((size, 3))
    for j in range(size):
        motion = 0.0
        for k in range(size):
            motion += chain.drive[j, k] * q[k]
        for i in range(3):
            places[j, i] = origin[i]
            pose.axes[j, i] = 0.0
            for k in range(3):
                pose.axes[j, i] += rotation[i, k] * chain.axes[j, k]
        _rotate(rotation, chain.axes[j], motion)
        following = chain.joints[j + 1] if j + 1 < size else chain.toe
        for i in range(3):
            for k in range(3):
                slide = rotation[i, k] * chain.slides[j, k]
                slides[j, i] += slide
                origin[i] += rotation[i, k] * (following[k] - chain.joints[j, k]) + motion * slide
    for i in range(3):
        pose.toe[i] = origin[i]
    for j in range(size):
        arm, axis = pose.toe - places[j], pose.axes[j]
        pose.columns[j, 0] = axis[1] * arm[2] - axis[2] * arm[1] + slides[j, 0]
        pose.columns[j, 1] = axis[2] * arm[0] - axis[0] * arm[2] + slides[j, 1]
        pose.columns[j, 2] = axis[0] * arm[1] - axis[1] * arm[0] + slides[j, 2]
    for i in range(3):
        for j in range(size):
            pose.jacobian[i, j] = 0.0
            for k in range(size):
                pose.jacobian[i, j] += pose.columns[k, i] * chain.drive[k, j]


@compiled
def _rotate(rotation: Array, axis: Array, angle: float) -> None:
    """Turn a rotation (3, 3) about an axis (3,) of the rotated frame, in place; none where zero."""
    x, y, z = axis[0], axis[1], axis[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return
    s, c = np.sin(angle), 1.0 - np.cos(angle)
    # Rodrigues
    turn = np.array([
        [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
        [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
        [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
    ])  # fmt: skip
    product = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            product[i, k] = (
                rotation[i, 0] * turn[0, k]
                + rotation[i, 1] * turn[1, k]
                + rotation[i, 2] * turn[2, k]
            )
    for i in range(3):
        for k in range(3):
            rotation[i, k] = product[i, k]


@compiled
def _compute_metric(
    chain: ChainTable, pose: ChainState, offset: Array, is_near: bool, metric: Array
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
    axes, columns = pose.axes, pose.columns
    square = pose.jacobian @ pose.jacobian.T
    trace = square[0, 0] + square[1, 1] + square[2, 2]
    multiplier = np.empty((3, 1))
    for i in range(3):
        square[i, i] += _REGULARISATION * trace
        multiplier[i, 0] = (pose.jacobian[i] * offset).sum()
    _solve_in_place(square, multiplier)
    curvature = np.zeros((size, size))
    for i in range(size):
        for j in range(i, size):
            curvature[i, j] = (
                multiplier[0, 0] * (axes[i, 1] * columns[j, 2] - axes[i, 2] * columns[j, 1])
                + multiplier[1, 0] * (axes[i, 2] * columns[j, 0] - axes[i, 0] * columns[j, 2])
                + multiplier[2, 0] * (axes[i, 0] * columns[j, 1] - axes[i, 1] * columns[j, 0])
            )
            curvature[j, i] = curvature[i, j]
    value, vector = np.linalg.eigh(np.eye(size) - chain.drive.T @ curvature @ chain.drive)
    for i in range(size):
        for j in range(size):
            metric[i, j] = 0.0
            for k in range(size):
                metric[i, j] += vector[i, k] * max(value[k], _MIN_CURVATURE) * vector[j, k]


@compiled
def _compute_step(chain: ChainTable, pose: ChainState, target: StepTarget, step: Array) -> None:
    """Compute the joint step (J,) towards the toe's target and, in the null space, towards home.

    Joints that a step would take beyond a bound are put on it, and the others step again: an active
    set.
    """
    size = len(step)
    free, fixed = chain.moves.copy(), np.zeros(size)
    for _ in range(size):
        _step_free_joints(pose.jacobian, target, free, fixed, step)
        is_beyond = False
        for j in range(size):
            if free[j] and (step[j] < target.down[j] or step[j] > target.up[j]):
                fixed[j] = min(max(step[j], target.down[j]), target.up[j])
                free[j] = False
                is_beyond = True
        if not is_beyond:
            break
    for j in range(size):
        if not free[j]:
            step[j] = fixed[j]


@compiled
def _step_free_joints(
    jacobian: Array, target: StepTarget, free: BoolArray, fixed: Array, step: Array
) -> None:
    """Compute the step of the free joints, zero of others; damped as Levenberg and Marquardt do."""
    size = len(step)
    masked, right = np.empty((size, size)), np.empty((size, 4))  # by toe force, and without any
    for j in range(size):
        for k in range(size):
            masked[j, k] = target.metric[j, k] if free[j] and free[k] else (1.0 if j == k else 0.0)
        for i in range(3):
            right[j, i] = jacobian[i, j] if free[j] else 0.0
        right[j, 3] = -target.offset[j] if free[j] else 0.0
    _solve_in_place(masked, right)
    square, residual = np.zeros((3, 3)), np.empty((3, 1))
    for i in range(3):
        residual[i, 0] = target.error[i]
        for j in range(size):
            residual[i, 0] -= jacobian[i, j] * fixed[j]
            if free[j]:
                residual[i, 0] -= jacobian[i, j] * right[j, 3]
                for k in range(3):
                    square[i, k] += jacobian[i, j] * right[j, k]
    damping = _DAMPING**2 * (square[0, 0] + square[1, 1] + square[2, 2]) + 1e-30
    damped, multiplier = square.copy(), residual.copy()
    for i in range(3):
        damped[i, i] += damping
    damped_again = damped.copy()
    _solve_in_place(damped, multiplier)
    # One refinement for the residual of damping, or the pull home would keep the toe off target
    for i in range(3):
        for k in range(3):
            residual[i, 0] -= square[i, k] * multiplier[k, 0]
    _solve_in_place(damped_again, residual)
    longest = 0.0
    for j in range(size):
        step[j] = right[j, 3]
        for k in range(3):
            step[j] += right[j, k] * (multiplier[k, 0] + residual[k, 0])
        longest = max(longest, abs(step[j]))
    scale = min(1.0, _MAX_JOINT_STEP / max(longest, 1e-300))
    for j in range(size):
        step[j] = step[j] * scale if free[j] else 0.0


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
