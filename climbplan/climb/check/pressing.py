"""Checks of forces under the motion's commands: body on its path, no slip, no overload."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import build_limbs, compute_body_axes
from climbplan.climb.check.anew.weights import compute_link_torques
from climbplan.climb.check.friction_factor import compute_friction_factor, format_min_factor
from climbplan.climb.check.grip_motion import check_grips_in_motion, compute_wrist_moment
from climbplan.climb.check.motion_forces import compute_motion_forces
from climbplan.climb.check.motion_state import (
    MotionState,
    compute_load,
    select_angles,
    select_instants,
)
from climbplan.climb.check.soles import check_soles_in_motion
from climbplan.robots.joint_units import format_largest_torques
from climbplan.verification.check import Check, judge_worst


def check_pressing(motion: MotionState) -> Iterator[Check]:
    """Yield checks that commands hold the body on its path, and that no limb slips or is
    overloaded.
    """
    plan = motion.subject.plan
    robot, trajectory = plan.robot, plan.trajectory
    k = select_instants(motion)
    normal, mu = plan.instants.normal[k], plan.instants.mu[k]
    motion_forces = compute_motion_forces(
        robot,
        trajectory.com,
        compute_body_axes(trajectory.rpy),
        standing=motion.standing,
        command=trajectory.joint_command,
        contact=~motion.lifted,
        load=compute_load(motion),
        moment=compute_wrist_moment(motion.subject, normal),
        arm=motion.arm,
        is_flat=motion.soles is not None,
    )
    deflection = _measure_deflections(motion_forces.deflection)
    yield judge_worst(
        "trajectory.command",
        np.where(np.isnan(deflection), np.inf, deflection),
        lambda sample, row: f"{motion.describe_sample(sample)}, {('shifted', 'turned')[row]}",
    )

    if motion.soles is not None:
        yield from check_soles_in_motion(motion, motion_forces, mu)
    elif robot.gripper is None:
        yield _check_friction(motion, motion_forces.force, normal, mu)
    else:
        limbs = build_limbs(
            robot, trajectory.com, compute_body_axes(trajectory.rpy), motion.standing.angles
        )
        yield from check_grips_in_motion(
            motion.subject, motion_forces.force, limbs, k, ~motion.lifted, motion.describe_sample
        )
    motor_torque = motion_forces.torque + compute_link_torques(
        robot, compute_body_axes(trajectory.rpy), select_angles(motion)
    )
    torque_ratio = np.abs(motor_torque) / robot.max_torque
    max_torque = f"at most {format_largest_torques(robot, motor_torque)}"
    yield judge_worst(
        "trajectory.torque",
        torque_ratio - 1.0,
        motion.describe_sample,
        margin=max_torque,
        used=torque_ratio,
    )


def _check_friction(motion: MotionState, force: Array, normal: Array, mu: Array) -> Check:
    """Check that forces (T, N, 3) are within their friction cones."""
    pressure = np.einsum("tni,tni->tn", force, normal)
    shear = np.linalg.norm(force - pressure[..., None] * normal, axis=-1)
    friction_factor = compute_friction_factor(
        "trajectory.friction", shear, mu * pressure, motion.subject.weight
    )
    friction_factor = np.where(motion.lifted, np.inf, friction_factor)
    excess = np.where(motion.lifted, -np.inf, shear - mu * pressure) / motion.subject.weight
    return judge_worst(
        "trajectory.friction",
        excess,
        motion.describe_sample,
        margin=format_min_factor(friction_factor),
        used=1 / np.maximum(friction_factor, 1e-300),
    )


def _measure_deflections(deflection: Array) -> Array:
    """Return shift [m] and rotation [rad] (T, 2) of body deflections (T, 6)."""
    components = (deflection[:, :3], deflection[:, 3:])
    return np.stack([np.linalg.norm(component, axis=1) for component in components], axis=1)
