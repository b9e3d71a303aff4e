"""Where the attitude may be: a tube about a known motion, and what turns within it at most.

The statement that the mixed-integer program bounds keeps roll, pitch, yaw and the angular velocity
within a tube, as the published one keeps them within Table 8.4. Within it each entry of rotation,
rates and inertia is its value at the middle, off by no more than what is found here: the largest on
a grid, and what a function with such second derivatives is off from its multilinear interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.walking.check.truth import knot_step
from climbplan.walking.task.task import ANGLES, SPIN, WalkTask

_GRID = 21  # points an angle
_ROUNDING = 1e-12
_LEAST = 1e-7  # [rad/s] beyond an angular velocity: rounding, and no range is narrower
_NEAR = 0.5  # [rad] a reference that near is part of the tube


@dataclass(frozen=True)
class Tube:
    """Middles and half widths at knots 0 to N."""

    angles: Array  # (N + 1, 3) [rad]
    angles_half: Array
    spin: Array  # (N + 1, 3) [rad/s]
    spin_half: Array
    heading: Array  # (N + 1,) [rad] yaw of the axes that arms and forces are along

    def holds(self, state: Array) -> bool:
        """Whether a motion (N + 1, 12) is within it."""
        turned, turning = self.beyond(state)
        return bool(turned.max() <= 1e-9 and turning.max() <= 1e-9)

    def beyond(self, state: Array) -> tuple[Array, Array]:
        """How far a motion (N + 1, 12) leaves it (3,) [rad], (3,) [rad/s]; 0 or less within it.

        The angular velocity at the end turns nothing.
        """
        turned = np.abs(state[:, ANGLES] - self.angles) - self.angles_half
        turning = np.abs(state[:-1, SPIN] - self.spin[:-1]) - self.spin_half[:-1]
        return turned.max(axis=0), turning.max(axis=0)


def tube_about(task: WalkTask, state: Array, angles: Array, spin: Array) -> Tube:
    """So much room (3,) on either side of motions (..., N + 1, 12), and of references near them.

    Of several motions it holds all that is between them at each knot. Where the start alone
    decides, at the first two knots of forward Euler, there is no room.
    """
    state = state.reshape(-1, *state.shape[-2:])
    reference = np.vstack([task.start.state[ANGLES], task.reference.euler])
    turned = state[..., ANGLES]
    near = np.where(np.abs(reference - turned) < _NEAR, reference, turned)
    low = np.minimum(turned, near).min(axis=0) - angles
    high = np.maximum(turned, near).max(axis=0) + angles
    turning = state[..., SPIN]
    still = np.abs(turning) < _NEAR * 10
    slow = np.where(still, np.minimum(turning, 0.0), turning).min(axis=0) - spin
    fast = np.where(still, np.maximum(turning, 0.0), turning).max(axis=0) + spin
    none = np.zeros((1, task.body.leg_count, 3))
    after = knot_step(task.body, "euler", task.step, task.start.state[None], none, none)[0]
    low[0] = high[0] = task.start.state[ANGLES]
    low[1] = high[1] = after[ANGLES]
    slow[0] = fast[0] = task.start.state[SPIN]
    middle = 0.5 * (low + high)
    return Tube(
        middle, 0.5 * (high - low), 0.5 * (slow + fast), 0.5 * (fast - slow), middle[:, 2].copy()
    )


@dataclass(frozen=True)
class Turning:
    """Rotation, inertia and turning at a knot of a tube, and how far off they are at most."""

    R: Array  # (3, 3) at the middle
    R_off: Array  # (3, 3)
    inverse: Array  # (3, 3) inverse inertia, world frame
    inverse_off: Array  # (3, 3)
    inertia: Array  # (3, 3) world frame
    inertia_off: Array  # (3, 3)
    heavy_low: Array  # (3, 3) inertia about `principal` at the middle, less its linearisation, from
    heavy_high: Array  # to
    carried_low: Array  # (3, 3) rotation from there about the same axes, less its linearisation
    carried_high: Array
    principal: Array  # (3, 3) principal axes of the inertia in the body, its columns
    moments: Array  # (3,) of inertia about them
    about_low: Array  # (3,) least angular velocity about them
    about_high: Array
    axes: Array  # (3, 3) small turn about the body's axes at the middle, by each angle
    turn_half: Array  # (3,) of that turn at most
    spin_low: Array  # (3,) (R^T R_middle - 1 + [turn]) R_middle^T w for spins w, least
    spin_high: Array  # and largest
    facing: Array  # (3, 3) axes of the heading, its columns
    arm_low: Array  # (L, 3) least toe from the body about them
    arm_high: Array
    reach_low: Array  # (L, 3) and in the world frame
    reach_high: Array
    toe_low: Array  # (L, 3) R_middle^T r of a toe's arm r, least
    toe_high: Array  # and largest
    bent_low: Array  # (L, 3) (R^T R_middle - 1 + [turn]) R_middle^T r, least
    bent_high: Array  # and largest


_KEPT = 256
_kept: dict[bytes, Turning] = {}  # what was asked last: parts of a tube differ at few knots


def turning(task: WalkTask, tube: Tube, n: int) -> Turning:
    """What turns at knot n."""
    body = task.body
    numbers = [
        body.inertia,
        body.toe_center,
        body.toe_half,
        *(row[n] for row in vars(tube).values()),
    ]
    key = np.concatenate([np.ravel(one) for one in numbers]).tobytes()
    if key not in _kept:
        if len(_kept) >= _KEPT:
            _kept.clear()
        _kept[key] = _turning(task, tube, n)
    return _kept[key]


def _turning(task: WalkTask, tube: Tube, n: int) -> Turning:
    middle, half = tube.angles[n], tube.angles_half[n]
    axes = [
        np.linspace(m - h, m + h, _GRID) if h > 0 else np.array([m])
        for m, h in zip(middle, half, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turns = rotation_world_body(grid)
    R = rotation_world_body(middle)
    inertia = task.body.inertia
    body_inverse = np.linalg.inv(inertia)
    # Of what turns with the body, R J R^T, second derivatives are at most twice the spread of J.
    spread = np.ptp(np.linalg.eigvalsh(body_inverse))
    inverse = R @ body_inverse @ R.T
    inverses = turns @ body_inverse @ np.swapaxes(turns, -1, -2)
    heavy, turned_heavies = R @ inertia @ R.T, turns @ inertia @ np.swapaxes(turns, -1, -2)
    # Interpolation in a cell is off by an eighth of side^2 times second derivative for each angle.
    # Entries of rotations are constant, or sinusoids of each angle, no larger than 1.
    beside = float(((2.0 * half / (_GRID - 1)) ** 2).sum()) / 8.0 + _ROUNDING
    R_off = np.abs(turns - R).max(axis=0) + beside
    turned = np.einsum("ba,jbc->jac", R, _slopes(middle))  # skew: what a rotation is to first order
    turns_by = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]])
    turn = skew((grid - middle) @ turns_by.T)
    second = np.swapaxes(turns, -1, -2) @ R - np.eye(3) + turn
    spin, spin_half = tube.spin[n], tube.spin_half[n]
    fastest = float(np.linalg.norm(np.abs(spin) + spin_half))
    spins = _swept(second @ R.T, spin[None], spin_half, beside * fastest)
    boxes, half_box = task.body.toe_center, task.body.toe_half
    furthest = float(np.linalg.norm(np.abs(boxes) + half_box, axis=1).max())
    facing = rotation_world_body(np.array([0.0, 0.0, tube.heading[n]]))
    arms = _swept(facing.T @ turns, boxes, half_box, beside * furthest)
    toes = _swept(R.T @ turns, boxes, half_box, beside * furthest)
    # Of the turn times a rotation: twice the slope of the latter, and the turn times what it bends.
    bends = (3.0 + float(np.linalg.norm(np.abs(turns_by) @ half))) * beside * furthest
    bent = _swept(second @ R.T @ turns, boxes, half_box, bends)
    world = _swept(turns, boxes, half_box, beside * furthest)
    moments, principal = np.linalg.eigh(inertia)
    principal[:, 2] *= np.linalg.det(principal)  # right-handed
    Q = principal.T @ R.T @ turns @ principal
    across = skew((grid - middle) @ turns_by.T @ principal)
    carried = Q - np.eye(3) - across
    heavies = Q * moments @ np.swapaxes(Q, -1, -2) - np.diag(moments)
    heavies -= across * (moments[None, :] - moments[:, None])
    about_low, about_high = _about(turns @ principal, beside, tube.spin[n], tube.spin_half[n])
    return Turning(
        R,
        R_off,
        inverse,
        np.abs(inverses - inverse).max(axis=0) + 2.0 * spread * beside,
        heavy,
        np.abs(turned_heavies - heavy).max(axis=0) + 2.0 * float(np.ptp(moments)) * beside,
        heavies.min(axis=0) - 2.0 * float(np.ptp(moments)) * beside,
        heavies.max(axis=0) + 2.0 * float(np.ptp(moments)) * beside,
        carried.min(axis=0) - beside,
        carried.max(axis=0) + beside,
        principal,
        moments,
        about_low,
        about_high,
        turns_by,
        np.abs(turns_by) @ half,
        spins[0][0],
        spins[1][0],
        facing,
        *arms,
        *world,
        *toes,
        *bent,
    )


def _swept(maps: Array, middle: Array, half: Array, beyond: float) -> tuple[Array, Array]:
    """Least and largest of what linear maps (G, 3, 3) make of boxes about middles (M, 3): (M, 3).

    beyond: by how much maps between those of the grid may be further.
    """
    centers = np.einsum("gjk,mk->gmj", maps, middle)
    room = np.einsum("gjk,k->gj", np.abs(maps), half)[:, None]
    return (centers - room).min(axis=0) - beyond, (centers + room).max(axis=0) + beyond


def _slopes(angles: Array) -> Array:
    """Of the rotation by each angle (3, 3, 3): half a turn further it is its own derivative."""
    ahead, back = angles + 0.5 * np.pi * np.eye(3), angles - 0.5 * np.pi * np.eye(3)
    # Entries are constant, or sinusoids of each angle, so that the difference is exact.
    result: Array = 0.5 * (rotation_world_body(ahead) - rotation_world_body(back))
    return result


def _about(turns: Array, beside: float, spin: Array, half: Array) -> tuple[Array, Array]:
    """Least and largest angular velocity (3,) about axes that turn (G, 3, 3), its columns.

    beside: by how much entries of the axes may be beyond those of the grid, for any spin of 1.
    """
    middle, room = np.einsum("gjk,j->gk", turns, spin), np.einsum("gjk,j->gk", np.abs(turns), half)
    fastest = float(np.linalg.norm(np.abs(spin) + half))
    further = beside * fastest + _LEAST
    low = np.maximum((middle - room).min(axis=0) - further, -fastest - _LEAST)
    high = np.minimum((middle + room).max(axis=0) + further, fastest + _LEAST)
    return low, high
