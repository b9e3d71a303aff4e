"""Inverse kinematics of chains with any number of joints: the posture nearest to a given one.

Of all angles q within their bounds that put the toe at x, the one nearest to the limb's own posture
q0 is taken: least |q - q0|^2 subject to p(q) = x, lengths of sliding joints counted in units of
`RADIAN` (0.25 m). Steps of damped Gauss-Newton go from q0 along the straight line to x, with what
they leave free spent on getting back to q0, and joints that would leave their bounds held there.
The answer depends on x alone, so that a toe that comes back finds the same angles, and moves
without a jump where the toe does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.chain_pose import ChainPose, ChainZero

REACHED = 1e-9  # [m] of a toe from its place
_ITERATIONS = 80
_STRIDE = 0.06  # [m] of the straight line in one step
_DAMPING = 1e-5  # of the Jacobian's largest singular value, squared in the step
_LONGEST = 0.5  # [rad] turned by a joint in one step
_SETTLED = 1e-10  # [rad] by which the free motion still turns joints
_NEAR = 0.02  # [m] from the toe's place, within which the free motion's curvature counts
_FIRM = 0.2  # least curvature counted
_SLIGHT = 1e-9  # of the Jacobian's square
_NEARER = 0.99  # of the least distance so far, which counts as progress
_STALLED = 12  # steps without any, after which a toe is given up that the limb is too short for
_CHUNK = 20_000  # toes at a time: what fits into a cache and a laptop


@dataclass(frozen=True)
class ChainAngles:
    """Answers for F toes."""

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
    """Angles of limbs (F,) that put toes at (F, 3) within bounds (F, J), body frame.

    chain, posture: (N, J) of all limbs.
    """
    if chain.slides is None:
        return _turning_inverse(chain, posture, limbs, toes, lower, upper)
    unit = chain.unit
    own = unit[limbs]
    found = _turning_inverse(
        chain.in_radians(), posture / unit, limbs, toes, lower / own, upper / own
    )
    inside = np.clip(found.angles * own, lower, upper)
    return ChainAngles(inside, found.reached, found.missing)


def _turning_inverse(
    chain: ChainZero,
    posture: Array,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
) -> ChainAngles:
    """The same with all angles in radians."""
    if len(toes) > _CHUNK:
        parts = [
            _turning_inverse(chain, posture, limbs[s], toes[s], lower[s], upper[s])
            for s in (slice(at, at + _CHUNK) for at in range(0, len(toes), _CHUNK))
        ]
        return ChainAngles(*(np.concatenate([vars(p)[n] for p in parts]) for n in vars(parts[0])))
    geometry = chain.rows(limbs)
    home = np.clip(posture[limbs], lower, upper)
    angles = home.copy()
    moves = geometry.moves  # (F, J) joints that a limb really has
    active = np.flatnonzero(np.isfinite(toes).all(axis=1))
    best, least = home.copy(), np.full(len(toes), np.inf)  # where toes are nearest to their places
    mark, stalled = least.copy(), np.zeros(len(toes), np.int64)
    # Others may get there after any number of steps to and fro
    patience = np.where(_too_far(geometry, toes, lower, upper), _STALLED, _ITERATIONS)
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        q = angles[active]
        pose = geometry.rows(active).pose(q)
        jacobian, error = pose.jacobian, toes[active] - pose.toe
        distance = np.linalg.norm(error, axis=1)
        nearest = distance < least[active]
        best[active[nearest]], least[active[nearest]] = q[nearest], distance[nearest]
        nearer = distance < _NEARER * mark[active]
        mark[active[nearer]] = distance[nearer]
        stalled[active] = np.where(nearer | (distance < REACHED), 0, stalled[active] + 1)
        error *= np.minimum(1.0, _STRIDE / np.maximum(distance, 1e-300))[:, None]
        away = q - home[active]
        metric = _metric(pose, away, distance < _NEAR)
        room = lower[active] - q, upper[active] - q
        step = _step(jacobian, error, -away, metric, moves[active], *room)
        angles[active] = np.clip(q + step, lower[active], upper[active])
        settled = (distance < REACHED / 10) & (np.abs(step).max(axis=1) < _SETTLED)
        active = active[~settled & (stalled[active] < patience[active])]
    missing = np.linalg.norm(toes - geometry.pose(angles).toe, axis=1)
    # Steps of damped Gauss-Newton go to and fro where a toe is out of reach
    lost = (missing > REACHED) & (least < missing) & (least > REACHED)
    angles[lost], missing[lost] = best[lost], least[lost]
    return ChainAngles(angles, missing <= REACHED, np.where(np.isnan(missing), np.inf, missing))


def _too_far(geometry: ChainZero, toes: Array, lower: Array, upper: Array) -> BoolArray:
    """(F,) toes farther from the first joint than all links and slides in one line."""
    ends = np.concatenate([geometry.joints, geometry.toe[:, None]], axis=1)
    long = np.linalg.norm(np.diff(ends, axis=1), axis=-1).sum(axis=-1)
    if geometry.slides is not None:
        most = np.maximum(np.abs(lower), np.abs(upper))
        if geometry.drive is not None:
            most = (np.abs(geometry.drive) @ most[..., None])[..., 0]
        long = long + (np.linalg.norm(geometry.slides, axis=-1) * most).sum(axis=-1)
    return np.asarray(np.linalg.norm(toes - geometry.joints[:, 0], axis=1) > long + REACHED)


def _metric(pose: ChainPose, away: Array, near: BoolArray) -> Array:
    """(A, J, J) Hessian of the Lagrangian of |q - q0|^2 / 2 with the toe held, at least _FIRM.

    Without it, steps along the free motion overshoot where limbs are nearly stretched. away: (A, J)
    q - q0. Far from the toe's place, where `near` (A,) does not hold, it is the identity.
    """
    count = away.shape[-1]
    out = np.broadcast_to(np.eye(count), (len(away), count, count)).copy()
    if count == 3 or not near.any():
        return out
    jacobian = pose.jacobian[near]
    square = jacobian @ np.swapaxes(jacobian, -1, -2)
    size = np.trace(square, axis1=1, axis2=2)[:, None, None]
    pull = (jacobian @ away[near][..., None])[..., 0]
    multiplier = np.linalg.solve(square + _SLIGHT * size * np.eye(3), pull[..., None])[..., 0]
    bent = np.einsum("aijk,ai->ajk", pose.hessian[near], multiplier)
    value, vector = np.linalg.eigh(np.eye(count) - bent)
    scaled = vector * np.maximum(value, _FIRM)[:, None, :]
    out[near] = scaled @ np.swapaxes(vector, -1, -2)
    return out


def _step(
    jacobian: Array,
    error: Array,
    home: Array,
    metric: Array,
    moves: BoolArray,
    down: Array,
    up: Array,
) -> Array:
    """Joint turns (A, J) towards the toe's place and, as far as that leaves open, towards home.

    jacobian: (A, 3, J); error: (A, 3); home, down, up: (A, J) turns to the posture and the bounds;
    metric: (A, J, J) by which turns are weighed. Joints that a step would take beyond a bound are
    put on it and the others step again.
    """
    free = moves.copy()
    held = np.zeros_like(home)
    identity = np.eye(jacobian.shape[-1])
    for _ in range(jacobian.shape[-1]):
        part = jacobian * free[:, None, :]
        both = free[:, :, None] & free[:, None, :]
        right = np.concatenate([np.swapaxes(part, -1, -2), (home * free)[..., None]], axis=-1)
        solved = np.linalg.solve(np.where(both, metric, identity), right)
        turns, wish = solved[..., :3], solved[..., 3]  # by toe force, and without any
        square = part @ turns
        size = np.trace(square, axis1=1, axis2=2)[:, None, None]
        damped = square + (_DAMPING**2 * size + 1e-30) * np.eye(3)
        left = error - (jacobian @ held[..., None])[..., 0] - (part @ wish[..., None])[..., 0]
        answer = np.linalg.solve(damped, left[..., None])
        # Once more for what damping left undone, or the pull home would hold the toe off its place
        answer += np.linalg.solve(damped, left[..., None] - square @ answer)
        step = (turns @ answer)[..., 0] + wish
        most = np.abs(step).max(axis=1, keepdims=True)
        step = step * np.minimum(1.0, _LONGEST / np.maximum(most, 1e-300)) * free
        beyond = free & ((step < down) | (step > up))
        if not beyond.any():
            break
        held = np.where(beyond, np.clip(step, down, up), held)
        free &= ~beyond
    return np.where(free, step, held)
