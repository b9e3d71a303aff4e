"""Motor torques of a swinging leg, by inverse dynamics of its links.

Walking plans have massless legs, so that only the joint speed limits their swings.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.plan.swing_trajectory import quartic_arch, quintic_progress

_NUM_SAMPLES = 48  # of a swing
_DROPPED_SAMPLES = 3  # at both ends, where second differences are inaccurate


def compute_swing_effort(
    urdf: UrdfModel, legs: WalkingLegs, speed: float, step: float, lift: float, stance: int
) -> float:
    """Return the largest fraction of a torque limit that a swing takes.

    The body moves evenly.

    Args:
        urdf: The model of the robot.
        legs: Its legs.
        speed: Forward speed of the body [m/s].
        step: Duration of the swing [s].
        lift: Height of the swing [m].
        stance: Steps that a leg stands between two swings, half of them before its place at rest.

    Returns:
        The fraction; infinite where legs do not reach the swing trajectory.
    """
    chain = legs.chain
    joint_angles = _compute_swing_angles(legs, speed, step, lift, stance)
    if joint_angles is None:
        return np.inf
    dt = step / _NUM_SAMPLES
    joint_speeds = np.gradient(joint_angles, dt, axis=0)
    joint_accelerations = np.gradient(joint_speeds, dt, axis=0)
    max_fraction = 0.0
    for leg in range(len(chain.names)):
        for k in range(_DROPPED_SAMPLES, len(joint_angles) - _DROPPED_SAMPLES):
            torque = _compute_torques(
                urdf, legs, leg, joint_angles[k], joint_speeds[k], joint_accelerations[k]
            )
            drive_torque = np.where(legs.there[leg], np.abs(chain.drives[leg].T @ torque), 0.0)
            max_fraction = max(max_fraction, float((drive_torque / legs.max_torque[leg]).max()))
    return max_fraction


def compute_swing_speed(
    legs: WalkingLegs, speed: float, step: float, lift: float, stance: int
) -> float:
    """Return the largest fraction of a joint speed limit that a swing takes.

    The arguments are those of `compute_swing_effort`. The fraction is infinite where legs do not
    reach the swing trajectory.
    """
    joint_angles = _compute_swing_angles(legs, speed, step, lift, stance)
    if joint_angles is None:
        return np.inf
    joint_speeds = np.abs(np.gradient(joint_angles, step / _NUM_SAMPLES, axis=0))
    return float((joint_speeds / np.where(legs.there, legs.max_speed, np.inf)).max())


def _compute_swing_angles(
    legs: WalkingLegs, speed: float, step: float, lift: float, stance: int
) -> Array | None:
    """Return the angles (K, L, J) of joints in a swing; None where legs do not reach it."""
    phase = np.linspace(0.0, 1.0, _NUM_SAMPLES + 1)
    chain = legs.chain
    spots = np.repeat(chain.joint_points(chain.posture)[None, :, -1], len(phase), axis=0)
    progress = (stance + 1) * quintic_progress(phase)[0] - 0.5 * stance - phase
    spots[..., 0] += (speed * step * progress)[:, None]
    spots[..., 2] += (lift * quartic_arch(phase)[0])[:, None]
    solution = chain.inverse(spots, legs.lower, legs.upper)
    angles = solution.angles[..., 0, :, :]
    if not np.isfinite(angles).all() or not (solution.missing[..., 0, :] < 1e-3).all():
        return None
    joint_angles = (chain.drives @ angles[..., None])[..., 0]  # joints that follow others, too
    return np.asarray(joint_angles)


def _compute_torques(
    urdf: UrdfModel,
    legs: WalkingLegs,
    leg: int,
    joint_angles: Array,
    joint_speeds: Array,
    joint_accelerations: Array,
) -> Array:
    """Return the torques (J,) of one leg, all else at rest and the body upright.

    Args:
        urdf: The model of the robot.
        legs: Its legs.
        leg: Index of the leg.
        joint_angles: Angles (L, J).
        joint_speeds: Speeds (L, J).
        joint_accelerations: Accelerations (L, J).
    """
    pin, model, chain = urdf.library, urdf.model, legs.chain
    all_angles = (chain.drives @ chain.posture[..., None])[..., 0]
    all_angles[leg] = joint_angles[leg]
    angles = {
        name: float(angle)
        for names, row in zip(chain.names, all_angles, strict=True)
        for name, angle in zip(names, row, strict=True)
        if name
    }
    speed, acceleration = np.zeros(model.nv), np.zeros(model.nv)
    gravity = np.array(model.gravity.linear)
    up = urdf.root_to_base_rotation.T @ [0.0, 0.0, float(np.linalg.norm(gravity))]
    acceleration[:3] = up + gravity  # the model's own points down along the root's z
    index = np.full(len(chain.names[leg]), -1)
    for j, name in enumerate(chain.names[leg]):
        if name:
            index[j] = int(model.idx_vs[model.getJointId(name)])
            speed[index[j]], acceleration[index[j]] = (
                joint_speeds[leg, j],
                joint_accelerations[leg, j],
            )
    torque = np.array(
        pin.rnea(model, model.createData(), urdf.build_configuration(angles), speed, acceleration)
    )
    result: Array = np.where(index >= 0, torque[index], 0.0)
    return result
