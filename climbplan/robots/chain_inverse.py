"""Inverse kinematics of chains with any number of joints: the posture nearest to a given one.

    minimise    |q - q0|^2     over joint angles q
    subject to  p(q) = x       (the toe is at its place)
                l <= q <= u    (joint bounds)

with the limb's own posture q0 and lengths of prismatic joints counted in units of `RADIAN`
(0.25 m). Damped Gauss-Newton steps go from q0 along the straight line to x. Their null-space motion
reduces |q - q0|, and joints that would leave their bounds are fixed there. The answer depends on x
alone, so that a toe that comes back has the same angles, and angles are continuous where the toe's
path is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.chain_pose import ChainPose, ChainZero

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
_CHUNK = 20_000  # toes at a time, which fit into a cache


@dataclass(frozen=True)
class ChainAngles:
    """Solutions for F toes."""

    angles: Array  # (F, J) within the bounds [rad, or m of joints that slide]
    reached: BoolArray  # (F,)
    missing: Array  # (F,) distance left [m]


def chain_inverse(
    chain: ChainZero,
    posture: Array,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
) -> ChainAngles:
    """Solve the inverse kinematics of F toes.

    Args:
        chain: N limbs of J joints at zero angles.
        posture: Angles (N, J) to stay nearest to [rad, m].
        limbs: The limb of each toe (F,).
        toes: Positions (F, 3), body frame [m].
        lower: Lower bounds (F, J) [rad, m].
        upper: Upper bounds (F, J) [rad, m].
    """
    if chain.slides is None:
        return _solve_in_radians(chain, posture, limbs, toes, lower, upper)
    unit = chain.unit
    unit_by_toe = unit[limbs]
    solution = _solve_in_radians(
        chain.in_radians(), posture / unit, limbs, toes, lower / unit_by_toe, upper / unit_by_toe
    )
    inside = np.clip(solution.angles * unit_by_toe, lower, upper)
    return ChainAngles(inside, solution.reached, solution.missing)


def _solve_in_radians(
    chain: ChainZero,
    posture: Array,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
) -> ChainAngles:
    """Solve the inverse kinematics with all angles in radians; arguments like `chain_inverse`."""
    if len(toes) > _CHUNK:
        chunks = [
            _solve_in_radians(chain, posture, limbs[s], toes[s], lower[s], upper[s])
            for s in (slice(start, start + _CHUNK) for start in range(0, len(toes), _CHUNK))
        ]
        return ChainAngles(
            *(np.concatenate([vars(chunk)[n] for chunk in chunks]) for n in vars(chunks[0]))
        )
    geometry = chain.rows(limbs)
    home = np.clip(posture[limbs], lower, upper)
    angles = home.copy()
    moves = geometry.moves  # (F, J) joints that a limb really has
    active = np.flatnonzero(np.isfinite(toes).all(axis=1))
    best_angles, min_distance = home.copy(), np.full(len(toes), np.inf)
    reference, stalled = min_distance.copy(), np.zeros(len(toes), np.int64)
    # Others may converge after any number of oscillating steps
    patience = np.where(
        _are_out_of_reach(geometry, toes, lower, upper), _MAX_STALLED, _MAX_ITERATIONS
    )
    for _ in range(_MAX_ITERATIONS):
        if not len(active):
            break
        q = angles[active]
        pose = geometry.rows(active).pose(q)
        jacobian, error = pose.jacobian, toes[active] - pose.toe
        distance = np.linalg.norm(error, axis=1)
        is_best = distance < min_distance[active]
        best_angles[active[is_best]], min_distance[active[is_best]] = q[is_best], distance[is_best]
        is_progress = distance < _PROGRESS_RATIO * reference[active]
        reference[active[is_progress]] = distance[is_progress]
        stalled[active] = np.where(is_progress | (distance < REACHED), 0, stalled[active] + 1)
        error *= np.minimum(1.0, _MAX_TOE_STEP / np.maximum(distance, 1e-300))[:, None]
        offset = q - home[active]
        metric = _compute_metric(pose, offset, distance < _CURVATURE_RADIUS)
        bounds = lower[active] - q, upper[active] - q
        step = _compute_step(jacobian, error, -offset, metric, moves[active], bounds)
        angles[active] = np.clip(q + step, lower[active], upper[active])
        is_converged = (distance < REACHED / 10) & (np.abs(step).max(axis=1) < _STEP_TOLERANCE)
        active = active[~is_converged & (stalled[active] < patience[active])]
    missing = np.linalg.norm(toes - geometry.pose(angles).toe, axis=1)
    # Damped Gauss-Newton steps oscillate where a toe is out of reach
    is_worse = (missing > REACHED) & (min_distance < missing) & (min_distance > REACHED)
    angles[is_worse], missing[is_worse] = best_angles[is_worse], min_distance[is_worse]
    return ChainAngles(angles, missing <= REACHED, np.where(np.isnan(missing), np.inf, missing))


def _are_out_of_reach(geometry: ChainZero, toes: Array, lower: Array, upper: Array) -> BoolArray:
    """Return the toes (F,) farther from the first joint than all links and slides in one line."""
    ends = np.concatenate([geometry.joints, geometry.toe[:, None]], axis=1)
    length = np.linalg.norm(np.diff(ends, axis=1), axis=-1).sum(axis=-1)
    if geometry.slides is not None:
        max_extension = np.maximum(np.abs(lower), np.abs(upper))
        if geometry.drive is not None:
            max_extension = (np.abs(geometry.drive) @ max_extension[..., None])[..., 0]
        length = length + (np.linalg.norm(geometry.slides, axis=-1) * max_extension).sum(axis=-1)
    return np.asarray(np.linalg.norm(toes - geometry.joints[:, 0], axis=1) > length + REACHED)


def _compute_metric(pose: ChainPose, offset: Array, is_near: BoolArray) -> Array:
    """Return the Hessian (A, J, J) of the Lagrangian of |q - q0|^2 / 2 with the toe fixed.

    Its eigenvalues are at least `_MIN_CURVATURE`. Without it, null-space steps overshoot where
    limbs
    are nearly stretched. Where `is_near` (A,) is False it is the identity. offset: (A, J) q - q0.
    """
    count = offset.shape[-1]
    metric = np.broadcast_to(np.eye(count), (len(offset), count, count)).copy()
    if count == 3 or not is_near.any():
        return metric
    jacobian = pose.jacobian[is_near]
    square = jacobian @ np.swapaxes(jacobian, -1, -2)
    size = np.trace(square, axis1=1, axis2=2)[:, None, None]
    pull = (jacobian @ offset[is_near][..., None])[..., 0]
    multiplier = np.linalg.solve(square + _REGULARISATION * size * np.eye(3), pull[..., None])[
        ..., 0
    ]
    curvature = np.einsum("aijk,ai->ajk", pose.hessian[is_near], multiplier)
    value, vector = np.linalg.eigh(np.eye(count) - curvature)
    scaled = vector * np.maximum(value, _MIN_CURVATURE)[:, None, :]
    metric[is_near] = scaled @ np.swapaxes(vector, -1, -2)
    return metric


def _compute_step(
    jacobian: Array,
    error: Array,
    home: Array,
    metric: Array,
    moves: BoolArray,
    bounds: tuple[Array, Array],
) -> Array:
    """Return joint steps (A, J) towards the toe's target and, in the null space, towards home.

    Joints that a step would take beyond a bound are put on it, and the others step again: an active
    set. Damping is that of Levenberg and Marquardt.

    Args:
        jacobian: (A, 3, J).
        error: Of the toe (A, 3) [m].
        home: Steps (A, J) to the posture.
        metric: Hessian (A, J, J) of the objective.
        moves: (A, J) joints that the limb has.
        bounds: Steps (A, J) to the lower and to the upper bounds.
    """
    down, up = bounds
    free = moves.copy()
    fixed = np.zeros_like(home)
    identity = np.eye(jacobian.shape[-1])
    for _ in range(jacobian.shape[-1]):
        free_jacobian = jacobian * free[:, None, :]
        is_free = free[:, :, None] & free[:, None, :]
        right = np.concatenate(
            [np.swapaxes(free_jacobian, -1, -2), (home * free)[..., None]], axis=-1
        )
        solved = np.linalg.solve(np.where(is_free, metric, identity), right)
        force_steps, null_step = solved[..., :3], solved[..., 3]  # by toe force, and without any
        square = free_jacobian @ force_steps
        size = np.trace(square, axis1=1, axis2=2)[:, None, None]
        damped = square + (_DAMPING**2 * size + 1e-30) * np.eye(3)
        residual = error - (jacobian @ fixed[..., None])[..., 0]
        residual = residual - (free_jacobian @ null_step[..., None])[..., 0]
        multiplier = np.linalg.solve(damped, residual[..., None])
        # One refinement for the residual of damping, or the pull home would keep the toe off target
        multiplier += np.linalg.solve(damped, residual[..., None] - square @ multiplier)
        step = (force_steps @ multiplier)[..., 0] + null_step
        largest = np.abs(step).max(axis=1, keepdims=True)
        step = step * np.minimum(1.0, _MAX_JOINT_STEP / np.maximum(largest, 1e-300)) * free
        is_beyond = free & ((step < down) | (step > up))
        if not is_beyond.any():
            break
        fixed = np.where(is_beyond, np.clip(step, down, up), fixed)
        free &= ~is_beyond
    return np.where(free, step, fixed)
