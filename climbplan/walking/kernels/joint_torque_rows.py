"""Leg kinematics, and joint torques of standing legs as rows on contact forces, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_pose import RADIAN
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.parameters import LegChain

_MAX_ITERATIONS = 60
_POSITION_TOLERANCE, _ANGLE_TOLERANCE = 1e-11, 1e-9  # [m], [rad]
_MAX_STEP = 0.3  # [rad] of a joint in one iteration, which keeps the bend of the knee
_DAMPING = 1e-8  # of the Jacobian's squared norm, where it is nearly singular


@compiled
def select_leg(chains: LegChain, leg: int) -> LegChain:
    """Return one leg of chains whose arrays have a first axis (L,)."""
    return LegChain(
        chains.joint[leg], chains.axis[leg], chains.slide[leg], chains.drive[leg],
        chains.toe[leg], chains.posture[leg],
    )  # fmt: skip


@compiled
def _rotate_about(axis: Array, angle: float, R: Array) -> None:
    """Write the rotation (3, 3) about a unit axis (3,) by an angle, by Rodrigues' formula."""
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
def compute_leg_pose(chain: LegChain, angles: Array, jacobian: Array) -> Array:
    """Return the toe (3,) of a leg at angles (J,), and write its Jacobian (3, J); body frame."""
    joint, axis, slide = chain.joint, chain.axis, chain.slide
    drive, toe = chain.drive, chain.toe
    count = joint.shape[0]
    R, joint_rotation = np.eye(3), np.empty((3, 3))
    position, points = joint[0].copy(), np.empty((count, 3))
    axes, slides = np.empty((count, 3)), np.empty((count, 3))
    travel = drive @ angles
    for j in range(count):
        points[j] = position
        axes[j] = R @ axis[j]
        slides[j] = R @ slide[j]
        if axis[j, 0] != 0.0 or axis[j, 1] != 0.0 or axis[j, 2] != 0.0:
            _rotate_about(axis[j], travel[j], joint_rotation)
            R = R @ joint_rotation
        end = joint[j + 1] if j < count - 1 else toe
        position = position + R @ (end - joint[j]) + slides[j] * travel[j]
    by_joints = np.empty((3, count))
    for j in range(count):
        arm = position - points[j]
        by_joints[0, j] = axes[j, 1] * arm[2] - axes[j, 2] * arm[1] + slides[j, 0]
        by_joints[1, j] = axes[j, 2] * arm[0] - axes[j, 0] * arm[2] + slides[j, 1]
        by_joints[2, j] = axes[j, 0] * arm[1] - axes[j, 1] * arm[0] + slides[j, 2]
    jacobian[:] = by_joints @ drive
    return position


@compiled
def solve_leg_jacobian(chain: LegChain, spot: Array, jacobian: Array) -> bool:
    """Solve the inverse kinematics of a leg by damped Newton steps, and write its Jacobian.

    Steps from the nominal posture are short enough to keep its bend. A redundant leg (more than
    three joints) takes the angles nearest to the posture; lengths of sliding joints count in
    `RADIAN`.

    Args:
        chain: the leg.
        spot: (3,) toe, body frame [m].
        jacobian: (3, J) output.

    Returns:
        Whether the leg reaches the spot.
    """
    posture, slide = chain.posture, chain.slide
    angles, is_redundant = posture.copy(), posture.shape[0] > 3
    unit = np.ones(posture.shape[0])
    for j in range(posture.shape[0]):
        if slide[j, 0] != 0.0 or slide[j, 1] != 0.0 or slide[j, 2] != 0.0:
            unit[j] = RADIAN
    step = np.zeros_like(posture)
    for _ in range(_MAX_ITERATIONS):
        error = spot - compute_leg_pose(chain, angles, jacobian)
        distance = np.sqrt((error**2).sum())
        if distance < _POSITION_TOLERANCE and (
            not is_redundant or np.abs(step).max() < _ANGLE_TOLERANCE
        ):
            return True
        scaled = jacobian * unit
        square = scaled @ scaled.T
        damping = _DAMPING * (square[0, 0] + square[1, 1] + square[2, 2])
        for i in range(3):
            square[i, i] += damping
        if is_redundant:
            back = (posture - angles) / unit
            step = back + scaled.T @ np.linalg.solve(square, error - scaled @ back)
        else:
            step = scaled.T @ np.linalg.solve(square, error)
        longest = np.abs(step).max()
        angles += unit * step * min(1.0, _MAX_STEP / max(longest, 1e-300))
    return distance < 1e-6


@compiled
def write_torque_rows(
    chains: LegChain, state: Array, toes: Array, contact: BoolArray, scale: float, rows: Array
) -> None:
    """Write joint torques of standing legs as rows on force unknowns, J' R' f scale.

    Each standing leg has rows at the beginning and at the end of its interval. Where a leg does not
    reach its foothold they are zero, as the workspace rows are violated anyway.

    Args:
        chains: all legs, arrays with a first axis (L,).
        state: (N + 1, 12) point of linearisation.
        toes: (N + 1, L, 3) world frame [m].
        contact: (N + 1, L).
        scale: unit of the force unknowns [N].
        rows: (2 J F, Z) output, of F standing legs.
    """
    knots, legs = contact.shape
    joints = chains.joint.shape[1]
    R, jacobian = np.empty((3, 3)), np.empty((3, joints))
    count = 0
    for n in range(knots - 1):
        for leg in range(legs):
            if not contact[n, leg]:
                continue
            for late in range(2):
                rotation(state[n + late, 6:9], R)
                spot = R.T @ (toes[n, leg] - state[n + late, :3])
                is_reached = solve_leg_jacobian(select_leg(chains, leg), spot, jacobian)
                world = R @ jacobian
                for j in range(joints):
                    row = joints * (2 * count + late) + j
                    for i in range(3):
                        rows[row, 3 * count + i] = scale * world[i, j] if is_reached else 0.0
            count += 1
