"""What motors of standing legs may give, as rows on contact forces, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_pose import RADIAN
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled

_ITERATIONS = 60
_NEAR, _STILL = 1e-11, 1e-9  # [m], [rad]
_LONGEST = (
    0.3  # [rad] turned by a joint in one step: keeps to the bend of the knee that it stands in
)
_DAMPED = 1e-8  # of the Jacobian's squared size, where it is nearly singular


@compiled
def _turned_about(axis: Array, angle: float, R: Array) -> None:
    """R (3, 3) of a turn about a unit axis (3,)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    for i in range(3):
        for j in range(3):
            R[i, j] = (1.0 - cosine) * axis[i] * axis[j]
        R[i, i] += cosine
    R[0, 1] -= sine * axis[2]
    R[1, 0] += sine * axis[2]
    R[0, 2] += sine * axis[1]
    R[2, 0] -= sine * axis[1]
    R[1, 2] -= sine * axis[0]
    R[2, 1] += sine * axis[0]


@compiled
def leg_pose(
    joint: Array,
    axis: Array,
    slide: Array,
    drive: Array,
    toe: Array,
    angles: Array,
    jacobian: Array,
) -> Array:
    """The toe (3,) of a leg at angles (J,), and its Jacobian (3, J), body frame.

    joint, axis, slide (J, 3) and toe (3,) at zero angles: joints turn about axes, or slide along
    directions, where the axis is zero. drive: (J, J) how far joints move by angles.
    """
    count = joint.shape[0]
    R, one = np.eye(3), np.empty((3, 3))
    at, points = joint[0].copy(), np.empty((count, 3))
    axes, slides = np.empty((count, 3)), np.empty((count, 3))
    moved = drive @ angles
    for j in range(count):
        points[j] = at
        axes[j] = R @ axis[j]
        slides[j] = R @ slide[j]
        if axis[j, 0] != 0.0 or axis[j, 1] != 0.0 or axis[j, 2] != 0.0:
            _turned_about(axis[j], moved[j], one)
            R = R @ one
        end = joint[j + 1] if j < count - 1 else toe
        at = at + R @ (end - joint[j]) + slides[j] * moved[j]
    own = np.empty((3, count))
    for j in range(count):
        arm = at - points[j]
        own[0, j] = axes[j, 1] * arm[2] - axes[j, 2] * arm[1] + slides[j, 0]
        own[1, j] = axes[j, 2] * arm[0] - axes[j, 0] * arm[2] + slides[j, 1]
        own[2, j] = axes[j, 0] * arm[1] - axes[j, 1] * arm[0] + slides[j, 2]
    jacobian[:] = own @ drive
    return at


@compiled
def leg_jacobian(
    joint: Array,
    axis: Array,
    slide: Array,
    drive: Array,
    toe: Array,
    posture: Array,
    spot: Array,
    jacobian: Array,
) -> bool:
    """The Jacobian (3, J) of a leg whose toe is at a spot (3,); False where it does not get there.

    Newton's steps from the posture (J,), short enough to keep to its bend; of a leg of more than
    three joints to the angles that are nearest to it, as everywhere, lengths of joints that slide
    counted in `RADIAN`.
    """
    angles, free = posture.copy(), posture.shape[0] > 3
    unit = np.ones(posture.shape[0])
    for j in range(posture.shape[0]):
        if slide[j, 0] != 0.0 or slide[j, 1] != 0.0 or slide[j, 2] != 0.0:
            unit[j] = RADIAN
    step = np.zeros_like(posture)
    for _ in range(_ITERATIONS):
        off = spot - leg_pose(joint, axis, slide, drive, toe, angles, jacobian)
        distance = np.sqrt((off**2).sum())
        if distance < _NEAR and (not free or np.abs(step).max() < _STILL):
            return True
        turns = jacobian * unit
        square = turns @ turns.T
        damping = _DAMPED * (square[0, 0] + square[1, 1] + square[2, 2])
        for i in range(3):
            square[i, i] += damping
        if free:
            back = (posture - angles) / unit
            step = back + turns.T @ np.linalg.solve(square, off - turns @ back)
        else:
            step = turns.T @ np.linalg.solve(square, off)
        longest = np.abs(step).max()
        angles += unit * step * min(1.0, _LONGEST / max(longest, 1e-300))
    return distance < 1e-6


@compiled
def torque_rows(
    joint: Array,
    axis: Array,
    slide: Array,
    drive: Array,
    toe: Array,
    posture: Array,
    state: Array,
    toes: Array,
    contact: BoolArray,
    scale: float,
    rows: Array,
) -> None:
    """Rows (2 J F, Z): torques of the F standing legs' joints by force unknowns, J' R' f scale.

    Of each leg at the beginning of an interval and at its end, when the body has moved on. joint,
    axis, slide (L, J, 3), drive (L, J, J), toe (L, 3), posture (L, J): legs; state (N + 1, 12);
    toes (N + 1, L, 3); contact (N + 1, L). Where a leg does not reach, its workspace rows say so,
    and nothing is said here.
    """
    knots, legs = contact.shape
    joints = joint.shape[1]
    R, jacobian = np.empty((3, 3)), np.empty((3, joints))
    count = 0
    for n in range(knots - 1):
        for leg in range(legs):
            if not contact[n, leg]:
                continue
            for late in range(2):
                rotation(state[n + late, 6:9], R)
                spot = R.T @ (toes[n, leg] - state[n + late, :3])
                there = leg_jacobian(
                    joint[leg], axis[leg], slide[leg], drive[leg], toe[leg], posture[leg], spot,
                    jacobian,
                )  # fmt: skip
                world = R @ jacobian
                for j in range(joints):
                    row = joints * (2 * count + late) + j
                    for i in range(3):
                        rows[row, 3 * count + i] = scale * world[i, j] if there else 0.0
            count += 1
