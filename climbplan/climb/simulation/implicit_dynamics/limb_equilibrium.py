"""Compute the contact force of one limb with its toe at a given place, and its stiffness.

With the toe of a limb of three joints at p the contact force is
f = J^-T (spring(theta - command) - gravity), with spring torques that include backlash. Its
derivative by p is J^-T (k - f . d2p/dtheta2) J^-1. `redundant_limb_equilibrium.py` solves limbs of
more joints. All quantities are in the body frame.
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
    _apply_transpose,
    _dot,
    _invert,
    _set_diagonal,
    _transform_matrix,
)
from climbplan.climb.simulation.implicit_dynamics.redundant_limb_equilibrium import (
    _solve_redundant_limb,
)
from climbplan.climb.simulation.implicit_dynamics.state import JointSprings, ScratchMemory

_POSITION_TOLERANCE = 3e-5  # [m] an error that the next Newton step squares
_MAX_ITERATIONS = 12
_MAX_COMPLIANT_ITERATIONS = 25  # with a compliant toe


@compiled
def _solve_limb(
    zero: Array,
    limb: int,
    target: Array,
    springs: JointSprings,
    angles: Array,
    force: Array,
    contact_stiffness: Array,
    work: ScratchMemory,
) -> bool:
    """Solve a limb with its toe at a target (3,), body frame, and update its angles (n,) in place.

    zero: (2n + 1, 3) the limb at zero angles. force: (3,) on the toe. contact_stiffness: (3, 3)
    derivative of the force by the target. Returns False if the target is not reached.
    """
    if len(angles) > 3:
        return _solve_redundant_limb(
            zero, limb, target, springs, angles, force, contact_stiffness, work
        )
    if springs.toe_compliance[limb] > 0.0:
        return _solve_compliant_limb(
            zero, limb, target, springs, angles, force, contact_stiffness, work
        )
    jacobian, axes = work.jacobian, work.joint_axes
    inverse, hessian = work.matrices[rows.INVERSE], work.matrices[rows.HESSIAN]
    toe, toe_error = work.vectors[rows.TOE], work.vectors[rows.TOE_ERROR]
    angle_step, torque = work.vectors[rows.ANGLE_STEP], work.vectors[rows.TORQUE]
    joint_stiffness = work.vectors[rows.STIFFNESS]
    has_converged = False
    for _ in range(_MAX_ITERATIONS):
        _compute_kinematics(zero, angles, jacobian, axes, toe)
        volume = _invert(jacobian, inverse)
        springs.jacobian_volume[limb] = volume
        if not abs(volume) > MIN_VOLUME:
            return False
        for i in range(3):
            toe_error[i] = target[i] - toe[i]
        _apply_transpose(inverse, toe_error, angle_step)
        step_size = max(abs(angle_step[0]), abs(angle_step[1]), abs(angle_step[2]))
        scale = 1.0 if step_size <= MAX_JOINT_STEP else MAX_JOINT_STEP / step_size
        for j in range(3):
            angles[j] += scale * angle_step[j]
        if abs(toe_error[0]) + abs(toe_error[1]) + abs(toe_error[2]) < _POSITION_TOLERANCE:
            has_converged = True
            break
    if not has_converged:
        return False
    _compute_joint_torques(limb, angles, springs, torque, joint_stiffness)
    _apply_matrix(inverse, torque, force)
    _compute_joint_hessian(jacobian, axes, force, joint_stiffness, hessian)
    _transform_matrix(inverse, hessian, work.matrices[rows.BUFFER], contact_stiffness)
    return True


@compiled
def _solve_compliant_limb(
    zero: Array,
    limb: int,
    target: Array,
    springs: JointSprings,
    angles: Array,
    force: Array,
    contact_stiffness: Array,
    work: ScratchMemory,
) -> bool:
    """Solve a limb whose toe is compliant; arguments and results are those of `_solve_limb`.

    With toe compliance c and target t the joint angles solve
    J^T (t - p) / c = spring(theta - command) - gravity, by Newton's method. With
    H = k - f . d2p/dtheta2 the stiffness is df/dt = (I - J (J^T J + c H)^-1 J^T) / c.
    """
    compliance = springs.toe_compliance[limb]
    jacobian, axes = work.jacobian, work.joint_axes
    inverse, hessian = work.matrices[rows.INVERSE], work.matrices[rows.HESSIAN]
    toe, torque = work.vectors[rows.TOE], work.vectors[rows.TORQUE]
    torque_error, angle_step = work.vectors[rows.TORQUE_ERROR], work.vectors[rows.ANGLE_STEP]
    joint_stiffness = work.vectors[rows.STIFFNESS]
    step_size = 1.0
    for _ in range(_MAX_COMPLIANT_ITERATIONS):
        _compute_kinematics(zero, angles, jacobian, axes, toe)
        for i in range(3):
            force[i] = (target[i] - toe[i]) / compliance
        _compute_joint_torques(limb, angles, springs, torque, joint_stiffness)
        use_hessian = step_size < HESSIAN_THRESHOLD
        if use_hessian:
            _compute_joint_hessian(jacobian, axes, force, joint_stiffness, hessian)
        else:
            _set_diagonal(joint_stiffness, hessian)
        for i in range(3):
            torque_error[i] = _dot(jacobian[i], force) - torque[i]
            for j in range(3):
                hessian[i, j] = compliance * hessian[i, j] + _dot(jacobian[i], jacobian[j])
        _invert(hessian, inverse)
        _apply_matrix(inverse, torque_error, angle_step)
        step_size = 0.0
        for j in range(3):
            angle_step[j] *= compliance
            step_size = max(step_size, abs(angle_step[j]))
        scale = 1.0 if step_size <= MAX_JOINT_STEP else MAX_JOINT_STEP / step_size
        for j in range(3):
            angles[j] += scale * angle_step[j]
        if use_hessian and step_size < JOINT_TOLERANCE:
            springs.jacobian_volume[limb] = _compute_jacobian_volume(jacobian)
            _apply_transpose(jacobian, angle_step, torque_error)
            for i in range(3):
                force[i] -= torque_error[i] / compliance
            _compute_compliant_stiffness(
                jacobian, inverse, compliance, work.matrices[rows.RESPONSE], contact_stiffness
            )
            return True
    return False


@compiled
def _compute_compliant_stiffness(
    jacobian: Array, inverse: Array, compliance: float, response: Array, out: Array
) -> None:
    """Compute out = (I - J A J^T) / c with A = (J^T J + c H)^-1, and response = A J^T, (3, 3)."""
    for i in range(3):
        for j in range(3):
            response[i, j] = jacobian[0, j] * inverse[0, i]
            response[i, j] += jacobian[1, j] * inverse[1, i] + jacobian[2, j] * inverse[2, i]
    for i in range(3):
        for j in range(3):
            inner_product = 0.0
            for k in range(3):
                inner_product += jacobian[k, i] * response[k, j]
            out[i, j] = ((1.0 if i == j else 0.0) - inner_product) / compliance
