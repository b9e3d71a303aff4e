"""Compute the contact force of a limb of more than three joints with its toe at a given place.

The place of the toe does not determine the joint angles. They minimise the potential energy of the
joint springs subject to the place of the toe: spring(theta - command) - gravity = J^T f for a force
f at the toe. Newton's method solves for angles and force together. With H = k - f . d2p/dtheta2 and
toe compliance c a step d solves

    H d = J^T f - torque,    J d + c f = target - p.

H may be indefinite in directions that the contact constrains. The augmented Lagrangian term
r J^T J, r large, leaves the step unchanged and makes all pivots positive at a stable equilibrium.
"""

from __future__ import annotations

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    HESSIAN_THRESHOLD,
    JOINT_TOLERANCE,
    MAX_JOINT_STEP,
    MIN_VOLUME,
    _compute_jacobian_volume,
    _compute_joint_hessian,
    _compute_joint_torques,
    _compute_kinematics,
)
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import (
    _apply_matrix,
    _dot,
    _invert,
    _set_diagonal,
)
from climbplan.climb.simulation.implicit_dynamics.state import JointSprings, ScratchMemory

_MAX_ITERATIONS = 25
_PENALTY_FACTOR = 10.0  # r by the largest joint stiffness


@compiled
def _solve_redundant_limb(
    zero: Array,
    limb: int,
    target: Array,
    springs: JointSprings,
    angles: Array,
    force: Array,
    contact_stiffness: Array,
    work: ScratchMemory,
) -> bool:
    """Solve a redundant limb; arguments and results are those of `limb_equilibrium._solve_limb`.

    Returns False if there is no equilibrium with the toe at the target, or only an unstable one.
    """
    n, compliance = len(angles), springs.toe_compliance[limb]
    jacobian, axes, hessian = work.jacobian, work.joint_axes, work.joint_matrix
    toe, toe_error = work.vectors[rows.TOE], work.vectors[rows.TOE_ERROR]
    torque, joint_step = work.joint_vectors[rows.JOINT_TORQUE], work.joint_vectors[rows.JOINT_STEP]
    joint_stiffness = work.joint_vectors[rows.JOINT_STIFFNESS]
    angle_step = work.joint_vectors[rows.JOINT_ANGLE_STEP]
    joint_response = work.joint_response
    step_size = 1.0
    for _ in range(_MAX_ITERATIONS):
        _compute_kinematics(zero, angles, jacobian, axes, toe)
        springs.jacobian_volume[limb] = _compute_jacobian_volume(jacobian)
        if not (compliance > 0.0 or springs.jacobian_volume[limb] > MIN_VOLUME):
            return False
        _compute_joint_torques(limb, angles, springs, torque, joint_stiffness)
        use_hessian = step_size < HESSIAN_THRESHOLD
        if use_hessian:
            _compute_joint_hessian(jacobian, axes, force, joint_stiffness, hessian)
        else:
            _set_diagonal(joint_stiffness, hessian)
        penalty = _add_jacobian_penalty(jacobian, joint_stiffness, hessian)
        for j in range(n):
            joint_step[j] = torque[j]
            for a in range(3):
                joint_response[j, a] = jacobian[j, a]
        if not _solve_positive_system(hessian, joint_response, joint_step):
            return False
        for a in range(3):
            toe_error[a] = target[a] - toe[a]
        step_size = _solve_toe_force(compliance, penalty, force, contact_stiffness, work)
        scale = 1.0 if step_size <= MAX_JOINT_STEP else MAX_JOINT_STEP / step_size
        for j in range(n):
            angles[j] += scale * angle_step[j]
        if use_hessian and step_size < JOINT_TOLERANCE:
            return True
    return False


@compiled
def _solve_toe_force(
    compliance: float, penalty: float, force: Array, contact_stiffness: Array, work: ScratchMemory
) -> float:
    """Solve a Newton step for the force at the toe, and return its largest joint step [rad].

    Rows of `work` hold toe error, H^-1 J^T and H^-1 torque of the augmented H; the joint step is
    left there, force (3,) and stiffness (3, 3) in their arrays.
    """
    jacobian, joint_response = work.jacobian, work.joint_response
    toe_compliance, reaction = work.matrices[rows.TOE_COMPLIANCE], work.vectors[rows.REACTION]
    toe_target, toe_error = work.vectors[rows.TOE_TARGET], work.vectors[rows.TOE_ERROR]
    joint_step = work.joint_vectors[rows.JOINT_STEP]
    angle_step = work.joint_vectors[rows.JOINT_ANGLE_STEP]
    penalty_correction = 1.0 - penalty * compliance
    for a in range(3):
        toe_target[a] = toe_error[a] / penalty_correction
        for b in range(3):
            toe_compliance[a, b] = compliance / penalty_correction if a == b else 0.0
        for j in range(len(joint_step)):
            toe_target[a] += jacobian[j, a] * joint_step[j]
            for b in range(3):
                toe_compliance[a, b] += jacobian[j, a] * joint_response[j, b]
    _invert(toe_compliance, contact_stiffness)
    _apply_matrix(contact_stiffness, toe_target, reaction)
    largest_step = 0.0
    for j in range(len(joint_step)):
        angle_step[j] = _dot(joint_response[j], reaction) - joint_step[j]
        largest_step = max(largest_step, abs(angle_step[j]))
    for a in range(3):
        force[a] = (reaction[a] - penalty * toe_error[a]) / penalty_correction
        for b in range(3):
            contact_stiffness[a, b] = (
                contact_stiffness[a, b] / penalty_correction - (penalty if a == b else 0.0)
            ) / penalty_correction
    return largest_step


@compiled
def _add_jacobian_penalty(jacobian: Array, joint_stiffness: Array, matrix: Array) -> float:
    """Add r J^T J to a matrix (n, n) and return r [N/m]; jacobian: (n, 3) columns of J."""
    max_stiffness, max_column = 0.0, 1e-12
    for j in range(len(joint_stiffness)):
        max_stiffness = max(max_stiffness, joint_stiffness[j])
        max_column = max(max_column, _dot(jacobian[j], jacobian[j]))
    penalty = _PENALTY_FACTOR * max_stiffness / max_column
    for i in range(len(joint_stiffness)):
        for j in range(len(joint_stiffness)):
            matrix[i, j] += penalty * _dot(jacobian[i], jacobian[j])
    return float(penalty)


@compiled
def _solve_positive_system(matrix: Array, right_sides: Array, vector: Array) -> bool:
    """Solve matrix (n, n) x = right_sides (n, 3) and = vector (n,) in place; destroys the matrix.

    Returns False unless all pivots are positive, as they are at a stable equilibrium.
    """
    n = len(vector)
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 1e-9:
            return False
        for i in range(k + 1, n):
            factor = matrix[i, k] / pivot
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                vector[i] -= factor * vector[k]
                for a in range(3):
                    right_sides[i, a] -= factor * right_sides[k, a]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            vector[k] -= matrix[k, j] * vector[j]
            for a in range(3):
                right_sides[k, a] -= matrix[k, j] * right_sides[j, a]
        vector[k] /= matrix[k, k]
        for a in range(3):
            right_sides[k, a] /= matrix[k, k]
    return True
