"""Kinematics and joint springs of a limb of n joints, in the body frame.

A joint is a spring about its command, with backlash: a motor deflects it by torque / stiffness, and
within the backlash only a fraction of the stiffness is left.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.state import JointSprings

BACKLASH_STIFFNESS_RATIO = 0.2  # in the backlash, which is widened accordingly
_MIN_VOLUME_RATIO = 0.02  # Jacobian volume by length^3, below which a toe is compliant
MAX_JOINT_STEP = 0.15  # [rad] longest Newton step of a joint
JOINT_TOLERANCE = 5e-5  # [rad] a Newton step after which the next squares the error
HESSIAN_THRESHOLD = 0.02  # [rad] Newton steps below use second derivatives of the toe
MIN_VOLUME = 1e-7  # [m^3] Jacobian volume below which a limb is singular
MAX_TOE_COMPLIANCE = 5e-6  # [m/N] of the toe of a straight limb: 0.15 mm at 30 N


@compiled
def _compute_kinematics(
    zero_pose: Array, angles: Array, jacobian: Array, axes: Array, toe: Array
) -> None:
    """Compute toe (3,), Jacobian columns (n, 3) and joint axes (n, 3) at angles (n,).

    zero_pose: (2n + 1, 3) axes and places of the joints at zero angles and the toe, body frame. For
    limbs with prismatic joints it is (3n + 1, 3), with their directions at the end. The rows of
    `jacobian` hold the places of the joints until the toe is known.
    """
    n = len(angles)
    has_sliding_joints = len(zero_pose) > 2 * n + 1
    # Rotation of the links so far, row by row
    a00, a01, a02 = 1.0, 0.0, 0.0
    a10, a11, a12 = 0.0, 1.0, 0.0
    a20, a21, a22 = 0.0, 0.0, 1.0
    x, y, z = zero_pose[n, 0], zero_pose[n, 1], zero_pose[n, 2]
    for j in range(n):
        jacobian[j, 0], jacobian[j, 1], jacobian[j, 2] = x, y, z
        p, q, r = zero_pose[j, 0], zero_pose[j, 1], zero_pose[j, 2]
        u = a00 * p + a01 * q + a02 * r
        v = a10 * p + a11 * q + a12 * r
        w = a20 * p + a21 * q + a22 * r
        axes[j, 0], axes[j, 1], axes[j, 2] = u, v, w
        # A prismatic joint, whose axis is zero, does not rotate
        co, si = 1.0, 0.0
        if u != 0.0 or v != 0.0 or w != 0.0:
            co, si = np.cos(angles[j]), np.sin(angles[j])
        a00, a10, a20 = _rotate_column(a00, a10, a20, u, v, w, co, si)
        a01, a11, a21 = _rotate_column(a01, a11, a21, u, v, w, co, si)
        a02, a12, a22 = _rotate_column(a02, a12, a22, u, v, w, co, si)
        p = zero_pose[n + 1 + j, 0] - zero_pose[n + j, 0]
        q = zero_pose[n + 1 + j, 1] - zero_pose[n + j, 1]
        r = zero_pose[n + 1 + j, 2] - zero_pose[n + j, 2]
        if has_sliding_joints:
            # A prismatic joint does not rotate: the rotation is still that of the link before
            e, f, g = (
                zero_pose[2 * n + 1 + j, 0],
                zero_pose[2 * n + 1 + j, 1],
                zero_pose[2 * n + 1 + j, 2],
            )
            if e != 0.0 or f != 0.0 or g != 0.0:
                axes[j, 0] = a00 * e + a01 * f + a02 * g
                axes[j, 1] = a10 * e + a11 * f + a12 * g
                axes[j, 2] = a20 * e + a21 * f + a22 * g
            p += angles[j] * e
            q += angles[j] * f
            r += angles[j] * g
        x += a00 * p + a01 * q + a02 * r
        y += a10 * p + a11 * q + a12 * r
        z += a20 * p + a21 * q + a22 * r
    toe[0], toe[1], toe[2] = x, y, z
    for j in range(n):
        p, q, r = x - jacobian[j, 0], y - jacobian[j, 1], z - jacobian[j, 2]
        u, v, w = axes[j, 0], axes[j, 1], axes[j, 2]
        if (
            zero_pose[j, 0] == 0.0 and zero_pose[j, 1] == 0.0 and zero_pose[j, 2] == 0.0
        ):  # prismatic
            jacobian[j, 0], jacobian[j, 1], jacobian[j, 2] = u, v, w
            axes[j, 0], axes[j, 1], axes[j, 2] = 0.0, 0.0, 0.0
            continue
        jacobian[j, 0], jacobian[j, 1], jacobian[j, 2] = v * r - w * q, w * p - u * r, u * q - v * p


@compiled
def _rotate_column(
    x: float, y: float, z: float, u: float, v: float, w: float, co: float, si: float
) -> tuple[float, float, float]:
    """Rotate a vector c = (x, y, z) about a unit vector a = (u, v, w), by Rodrigues' formula

    c cos + (a x c) sin + a (a . c) (1 - cos); co, si are cosine and sine.
    """
    d = (1.0 - co) * (u * x + v * y + w * z)
    return (
        x * co + (v * z - w * y) * si + u * d,
        y * co + (w * x - u * z) * si + v * d,
        z * co + (u * y - v * x) * si + w * d,
    )


@compiled
def _compute_spring_torque(
    deflection: float, half_backlash: float, backlash_stiffness: float, stiffness: float
) -> float:
    """Return the torque of a joint at a deflection from its command [rad].

    Within the backlash the stiffness is `backlash_stiffness`, beyond it `stiffness` [N m/rad].
    """
    if deflection > half_backlash:
        return backlash_stiffness * half_backlash + stiffness * (deflection - half_backlash)
    if deflection < -half_backlash:
        return -backlash_stiffness * half_backlash + stiffness * (deflection + half_backlash)
    return backlash_stiffness * deflection


@compiled
def _compute_free_angles(limb: int, springs: JointSprings, out: Array) -> None:
    """Compute the angles (n,) of a limb in the air, whose links deflect the joints by weight."""
    for j in range(len(out)):
        gravity_torque, half_backlash = (
            springs.gravity_torque[limb, j],
            springs.half_backlash[limb, j],
        )
        backlash_stiffness, stiffness = (
            springs.backlash_stiffness[limb, j],
            springs.stiffness[limb, j],
        )
        breakaway_torque = backlash_stiffness * half_backlash
        if gravity_torque > breakaway_torque:
            deflection = half_backlash + (gravity_torque - breakaway_torque) / stiffness
        elif gravity_torque < -breakaway_torque:
            deflection = -half_backlash + (gravity_torque + breakaway_torque) / stiffness
        else:
            deflection = gravity_torque / backlash_stiffness
        out[j] = springs.command[limb, j] + deflection


@compiled
def _compute_joint_torques(
    limb: int, angles: Array, springs: JointSprings, torque: Array, stiffness: Array
) -> None:
    """Compute spring torques (n,) at angles (n,) less the links' weight, and stiffness (n,)."""
    for j in range(len(angles)):
        deflection = angles[j] - springs.command[limb, j]
        half_backlash, backlash_stiffness = (
            springs.half_backlash[limb, j],
            springs.backlash_stiffness[limb, j],
        )
        torque[j] = _compute_spring_torque(
            deflection, half_backlash, backlash_stiffness, springs.stiffness[limb, j]
        )
        stiffness[j] = (
            springs.stiffness[limb, j] if abs(deflection) > half_backlash else backlash_stiffness
        )
        torque[j] -= springs.gravity_torque[limb, j]


@compiled
def _compute_joint_hessian(
    jacobian: Array, axes: Array, force: Array, stiffness: Array, hessian: Array
) -> None:
    """Compute hessian (n, n) = k - f . d2p / dtheta_i dtheta_j of the potential energy.

    The second derivative of the toe p is axis_i x column_j for i <= j.
    """
    f0, f1, f2 = force[0], force[1], force[2]
    for j in range(len(stiffness)):
        c0, c1, c2 = jacobian[j, 0], jacobian[j, 1], jacobian[j, 2]
        # f . (axis x column) = axis . (column x f)
        t0, t1, t2 = c1 * f2 - c2 * f1, c2 * f0 - c0 * f2, c0 * f1 - c1 * f0
        for i in range(j):
            second_derivative = axes[i, 0] * t0 + axes[i, 1] * t1 + axes[i, 2] * t2
            hessian[i, j] = hessian[j, i] = -second_derivative
        hessian[j, j] = stiffness[j] - (axes[j, 0] * t0 + axes[j, 1] * t1 + axes[j, 2] * t2)


@compiled
def _compute_toe_compliance(zero_pose: Array, n: int, volume: float) -> float:
    """Return the compliance of the toe of a limb of n joints [m/N], 0 unless nearly straight.

    Compliance regularises the force of a limb near its singular posture. volume: of the limb's
    Jacobian [m^3].
    """
    length = 0.0
    for j in range(n):
        squared_length = 0.0
        for a in range(3):
            squared_length += (zero_pose[n + 1 + j, a] - zero_pose[n + j, a]) ** 2
        length += np.sqrt(squared_length)
    straightness = max(0.0, 1.0 - abs(volume) / (_MIN_VOLUME_RATIO * length**3))
    return float(MAX_TOE_COMPLIANCE * straightness * straightness)


@compiled
def _compute_jacobian_volume(jacobian: Array) -> float:
    """Return the volume of a Jacobian with columns (n, 3) [m^3], 0 at a singularity.

    It is the determinant for n = 3, else sqrt(det J J^T), Yoshikawa's manipulability, by the
    formula of Cauchy and Binet.
    """
    total, n = 0.0, len(jacobian)
    for i in range(n):
        for j in range(i + 1, n):
            for k in range(j + 1, n):
                volume = jacobian[i, 0] * (
                    jacobian[j, 1] * jacobian[k, 2] - jacobian[j, 2] * jacobian[k, 1]
                )
                volume += jacobian[i, 1] * (
                    jacobian[j, 2] * jacobian[k, 0] - jacobian[j, 0] * jacobian[k, 2]
                )
                volume += jacobian[i, 2] * (
                    jacobian[j, 0] * jacobian[k, 1] - jacobian[j, 1] * jacobian[k, 0]
                )
                if n == 3:
                    return float(volume)
                total += volume * volume
    return float(np.sqrt(total))
