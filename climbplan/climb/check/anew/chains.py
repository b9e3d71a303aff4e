"""Kinematics of serial chains from the data of the plan file, and their static equilibrium.

A chain is moved from its toe inwards, joint by joint, each about or along its axis at zero angles.
A coupled joint moves by a linear combination of the angles. Where a limb has more than three
joints, a held toe leaves a self-motion: the joints, springs about their commands, take the angles
of least elastic energy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.serial_chain import SerialChain

_MAX_ITERATIONS = 40
_MAX_STEP = 0.3  # [rad] of a Newton step, and [m]
_STEP_TOLERANCE = 1e-13  # [rad] of the last step
_CONVERGED_STEP = 1e-6  # [rad] of the last step, beyond which a limb has not settled
_TOE_TOLERANCE = 1e-7  # [m] of a toe from its place
_REGULARISATION = 1e-14  # [m/N] give of the toe, by which singular limbs have an answer


@dataclass(frozen=True)
class ChainLimbs:
    """Chains in the body frame."""

    joints: Array  # (..., N, J, 3) [m]
    axes: Array  # (..., N, J, 3) of joints that turn, zero of others
    toe: Array  # (..., N, 3) [m]
    slides: Array  # (..., N, J, 3) directions of joints that slide, zero of others
    drive: Array | None  # (N, J, J) how far joints move by angles, unless each by its own

    def compute_columns(self) -> Array:
        """Return the toe's velocity (..., N, J, 3) by the speed of each joint on its own."""
        return np.cross(self.axes, self.toe[..., None, :] - self.joints) + self.slides

    def jacobian(self) -> Array:
        """Return the Jacobian (..., N, 3, J) of the toes by the angles."""
        joint_columns = np.swapaxes(self.compute_columns(), -1, -2)
        return joint_columns if self.drive is None else joint_columns @ self.drive

    def compute_force_hessian(self, force: Array) -> Array:
        """Return the Hessian (..., N, J, J) of force . toe by the angles, forces (..., N, 3)."""
        columns = self.compute_columns()
        # f . (a_i x c_j) for i <= j, mirrored
        upper = np.einsum("...id,...jd->...ij", np.cross(force[..., None, :], self.axes), columns)
        upper = np.triu(upper)
        hessian = np.asarray(upper + np.swapaxes(np.triu(upper, 1), -1, -2))
        if self.drive is None:
            return hessian
        return np.asarray(np.swapaxes(self.drive, -1, -2) @ hessian @ self.drive)


def build_chains(chain: SerialChain, angles: Array) -> ChainLimbs:
    """Return chains at angles (..., N, J) [rad, or m of prismatic joints], body frame."""
    count = angles.shape[-1]
    shape = angles.shape[:-1]
    motions = compute_joint_motions(chain, angles)
    slide_axes = select_slide_axes(chain)
    slides = np.broadcast_to(slide_axes, (*shape, count, 3)).copy()
    joints = np.broadcast_to(chain.joint_zero, (*shape, count, 3)).copy()
    axes = np.broadcast_to(chain.axis_zero, (*shape, count, 3)).copy()
    toe = np.broadcast_to(chain.toe_zero, (*shape, 3)).copy()
    for j in reversed(range(count)):
        joint_origin, axis = chain.joint_zero[:, j], chain.axis_zero[:, j]
        angle = motions[..., j]
        slide = angle[..., None] * slide_axes[:, j]
        toe = joint_origin + _rotate_vectors(toe - joint_origin, axis, angle) + slide
        for outer_joint in range(j + 1, count):
            rotated = _rotate_vectors(joints[..., outer_joint, :] - joint_origin, axis, angle)
            joints[..., outer_joint, :] = joint_origin + rotated + slide
            axes[..., outer_joint, :] = _rotate_vectors(axes[..., outer_joint, :], axis, angle)
            slides[..., outer_joint, :] = _rotate_vectors(slides[..., outer_joint, :], axis, angle)
    return ChainLimbs(joints, axes, toe, slides, chain.drive)


def move_link_points(chain: SerialChain, angles: Array, points: Array) -> Array:
    """Return points (N, J, 3) of links at zero angles, moved with them by angles (..., N, J)."""
    motions, slide_axes = compute_joint_motions(chain, angles), select_slide_axes(chain)
    moved_points = np.broadcast_to(points, (*angles.shape, 3)).copy()
    for j in reversed(range(angles.shape[-1])):
        joint_origin, axis = chain.joint_zero[:, j], chain.axis_zero[:, j]
        angle = motions[..., j]
        for link in range(j, angles.shape[-1]):
            rotated = _rotate_vectors(moved_points[..., link, :] - joint_origin, axis, angle)
            moved_points[..., link, :] = (
                joint_origin + rotated + angle[..., None] * slide_axes[:, j]
            )
    return moved_points


def compute_joint_motions(chain: SerialChain, angles: Array) -> Array:
    """Return how far joints (..., N, J) move by angles (..., N, J), couplings included."""
    if chain.drive is None:
        return angles
    return np.einsum("nij,...nj->...ni", chain.drive, angles)


def select_slide_axes(chain: SerialChain) -> Array:
    """Return directions (N, J, 3) of prismatic joints at zero angles, zero for revolute ones."""
    return np.zeros_like(chain.axis_zero) if chain.slide_zero is None else chain.slide_zero


def rotate_to_zero(chain: SerialChain, angles: Array, vectors: Array) -> Array:
    """Return vectors (..., N, 3) of last links at angles (..., N, J), rotated with them to zero
    angles.
    """
    motions = compute_joint_motions(chain, angles)
    for j in range(motions.shape[-1]):
        vectors = _rotate_vectors(vectors, chain.axis_zero[:, j], -motions[..., j])
    return vectors


def rotate_by_chain(chain: SerialChain, angles: Array, vectors: Array) -> Array:
    """Return vectors (..., N, 3) of last links at zero angles, rotated with them by angles (..., N,
    J).
    """
    motions = compute_joint_motions(chain, angles)
    for j in reversed(range(motions.shape[-1])):
        vectors = _rotate_vectors(vectors, chain.axis_zero[:, j], motions[..., j])
    return vectors


@dataclass(frozen=True)
class EquilibriumChains:
    """Chains whose toes are held."""

    angles: Array  # (..., N, J) [rad]
    missing: Array  # (..., N) distance of the toes from their places [m]


def solve_chain_equilibrium(
    chain: SerialChain,
    toes: Array,
    initial: Array,
    command: Array,
    spring: Array,
    arm: Array | None = None,
) -> EquilibriumChains:
    """Return angles of least energy near `initial` (..., N, J) with toes at (..., N, 3), body
    frame.

    Newton's method solves k (q - command) = J^T f and toe(q) = x for angles q and toe forces f. The
    energy matters where a limb has a self-motion. Where a moving body has left the limb far from
    `initial`, so that the method does not converge, it starts again from the command, which moves
    with the body.

    Args:
        chain: The chains of all limbs.
        toes: (..., N, 3) positions of the toes [m].
        initial: (..., N, J) initial angles [rad].
        command: (..., N, J) commanded angles [rad].
        spring: (N, J) stiffness of the joints about their commands [N m/rad].
        arm: (..., N, 3) from toes to where forces act on feet of finite size [m]; None for the
            toes.
    """
    solution, is_converged = _solve_newton(chain, toes, initial, command, spring, arm)
    is_lost = ~is_converged | (solution.missing > _TOE_TOLERANCE)
    rows = np.asarray(is_lost.any(axis=-1))  # (...), some limb of which is lost
    if not rows.any():
        return solution
    retry, is_converged = _solve_newton(
        _select_chains(chain, rows),
        toes[rows],
        command[rows],
        command[rows],
        spring,
        None if arm is None else arm[rows],
    )
    is_better = is_lost[rows] & is_converged & (retry.missing <= _TOE_TOLERANCE)
    solution.angles[rows] = np.where(is_better[..., None], retry.angles, solution.angles[rows])
    solution.missing[rows] = np.where(is_better, retry.missing, solution.missing[rows])
    return solution


def _select_chains(chain: SerialChain, rows: BoolArray) -> SerialChain:
    """Return the chains of the rows (...) that are true, where a chain ends elsewhere in each row.

    Chains whose feet roll have a toe (..., N, 3) for each row; others have one (N, 3) for all.
    """
    if chain.toe_zero.ndim == 2:
        return chain
    toes = np.broadcast_to(chain.toe_zero, (*rows.shape, *chain.toe_zero.shape[-2:]))
    return replace(chain, toe_zero=toes[rows])


def _solve_newton(
    chain: SerialChain,
    toes: Array,
    start: Array,
    command: Array,
    spring: Array,
    arm: Array | None,
) -> tuple[EquilibriumChains, BoolArray]:
    """Apply Newton's method from angles `start` (..., N, J); return also where it converged (...,
    N).
    """
    shape, count = start.shape, start.shape[-1]
    q = start.copy()
    limbs = build_chains(chain, q)
    jacobian = limbs.jacobian()
    contact_limbs = _move_toes_to_contacts(limbs, arm)
    compliance = jacobian / spring[:, None, :] @ np.swapaxes(
        jacobian, -1, -2
    ) + _REGULARISATION * np.eye(3)
    initial_force = np.linalg.solve(compliance, (jacobian @ (q - command)[..., None]))
    force = np.asarray(initial_force[..., 0], np.float64)
    matrix = np.zeros((*shape[:-1], count + 3, count + 3))
    matrix[..., count:, count:] = _REGULARISATION * np.eye(3)
    for _ in range(_MAX_ITERATIONS):
        transposed = np.swapaxes(contact_limbs.jacobian(), -1, -2)
        matrix[..., :count, :count] = spring[:, None, :] * np.eye(
            count
        ) - contact_limbs.compute_force_hessian(force)
        matrix[..., :count, count:] = -transposed
        matrix[..., count:, :count] = jacobian
        torque_residual = (transposed @ force[..., None])[..., 0] - spring * (q - command)
        right_hand_side = np.concatenate([torque_residual, toes - limbs.toe], axis=-1)
        step = np.asarray(np.linalg.solve(matrix, right_hand_side[..., None])[..., 0], np.float64)
        max_change = np.abs(step[..., :count]).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _MAX_STEP / np.maximum(max_change, 1e-300))
        q = q + step[..., :count]
        force = force + step[..., count:]
        limbs = build_chains(chain, q)
        jacobian = limbs.jacobian()
        contact_limbs = _move_toes_to_contacts(limbs, arm)
        if not (max_change > _STEP_TOLERANCE).any():
            break
    missing = np.linalg.norm(toes - limbs.toe, axis=-1)
    return EquilibriumChains(q, missing), np.asarray(max_change[..., 0] <= _CONVERGED_STEP)


def _move_toes_to_contacts(limbs: ChainLimbs, arm: Array | None) -> ChainLimbs:
    """Return the limbs with the points at which forces act in place of their toes."""
    return limbs if arm is None else replace(limbs, toe=limbs.toe + arm)


def rotate_about_axis(points: Array, about: Array, axis: Array, angle: Array) -> Array:
    """Return points (..., 3) rotated about a unit axis (3,) through a point (3,), by angles (...)
    [rad].
    """
    return about + _rotate_vectors(points - about, axis, angle)


def _rotate_vectors(vector: Array, axis: Array, angle: Array) -> Array:
    """Rotate vectors (..., N, 3) about axes (N, 3), unit or zero, by angles (..., N) [rad]."""
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    axial = (vector * axis).sum(axis=-1, keepdims=True) * axis
    has_axis = (axis * axis).sum(axis=-1, keepdims=True) > 0
    rotated = axial + cos * (vector - axial) + sin * np.cross(axis, vector)
    return np.asarray(np.where(has_axis, rotated, vector))
